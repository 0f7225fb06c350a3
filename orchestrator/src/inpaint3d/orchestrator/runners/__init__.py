"""How a stage is started: as a process of this machine, or (once there are images) in a container."""
