"""The MMC agent that lets what it senses enter its network."""
