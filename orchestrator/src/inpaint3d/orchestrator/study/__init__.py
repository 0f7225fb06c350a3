"""What accuracy costs in time and memory, measured over many settings of a pipeline."""
