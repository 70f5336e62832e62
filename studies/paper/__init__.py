"""The paper's experiments, run again and set beside the published results."""
