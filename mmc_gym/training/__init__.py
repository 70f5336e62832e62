"""Learned policies: hyperparameters, training with checkpoints, learning curves."""
