"""Agents in closed loop: what they sense goes on correcting their internal model."""
