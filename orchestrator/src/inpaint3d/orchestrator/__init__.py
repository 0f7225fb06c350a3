"""Plans and runs pipelines of stages."""
