"""The body agents on other bodies: third-party environments, robots."""
