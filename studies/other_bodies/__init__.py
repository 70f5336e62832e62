"""The body agents on other bodies: environments of other people, real robots."""
