"""What the parts of `mmc-body` are worth, where it fails, and how it compares with others."""
