"""Inverse kinematics: one agent, and the solvers it may use."""
