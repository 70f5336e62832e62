"""Agents in parts around an internal model: senses, body, imagination, obstacles, drive."""
