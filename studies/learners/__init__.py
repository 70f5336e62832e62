"""What learners reach with their own defaults, and how fast."""
