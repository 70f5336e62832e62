"""Pictures of the arm, its target, and what disturbs it."""

import os

# Pygame greets on standard output, which may be piped.
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
