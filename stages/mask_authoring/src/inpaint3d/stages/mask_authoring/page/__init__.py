"""A local page on which a person points at what is to go, and sees the masks in every view."""
