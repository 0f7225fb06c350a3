"""The photos at their own size with the hole filled, as a data set."""
