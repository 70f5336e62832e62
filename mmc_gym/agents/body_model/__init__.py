"""An agent of five parts around an internal model: senses, body, locks, imagination, drive."""
