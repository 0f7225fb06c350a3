"""The contracts between stages: `models` of what they exchange, the `store` that keeps it, the `kit` they run in."""
