"""Experiments over trials: what agents learn from trial to trial, keep and carry over."""
