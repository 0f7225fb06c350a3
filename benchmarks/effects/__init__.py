"""Which effects are called for, against what they are worth: captures with a known answer, fields with and without."""
