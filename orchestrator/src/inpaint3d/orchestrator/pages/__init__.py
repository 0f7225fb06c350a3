"""The pages that people forward: the report of a run, two runs side by side, the list of runs."""
