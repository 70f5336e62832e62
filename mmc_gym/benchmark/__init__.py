"""Agents × scenarios × training seeds: play, keep, compare, rank."""
