"""How a stage is started: as a process of this machine, or in a container."""
