"""Whether success is a property of the arm or of its solver."""
