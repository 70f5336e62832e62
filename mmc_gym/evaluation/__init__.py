"""Agents at work: rollouts, movement measures, statistics, tables and figures."""
