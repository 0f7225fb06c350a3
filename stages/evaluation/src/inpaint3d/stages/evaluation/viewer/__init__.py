"""A local page to look around in the fields of a run, and a film of the way around."""
