"""The contracts between stages: `models` of what they exchange, the `store` that keeps it, the `kit` they run in."""

import os

# Pydantic would look through every installed package for plugins, and let any of them change what is valid.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
