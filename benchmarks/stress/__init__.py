"""What the service promises under load and through faults, measured on a real server: see `benchmarks.stress.run`."""
