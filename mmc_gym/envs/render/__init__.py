"""Pictures of the arm, its target, and what disturbs it."""
