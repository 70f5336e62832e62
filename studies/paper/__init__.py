"""The paper's experiments, and what they measured when it was published."""
