"""From an episode to numbers: rollouts, and measures with their labels and units."""
