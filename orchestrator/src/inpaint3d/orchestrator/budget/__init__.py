"""A run within a time, a memory or up to an accuracy, by what a study measured."""
