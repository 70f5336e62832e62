"""Studies of learning over trials."""
