"""Which effects a scene calls for, with evidence."""
