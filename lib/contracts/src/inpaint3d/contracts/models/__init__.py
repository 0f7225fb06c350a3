"""What is exchanged and written down: artifacts and their manifests, `stage.yaml`, `pipeline.yaml`, records of runs."""
