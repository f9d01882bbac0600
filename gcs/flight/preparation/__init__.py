"""Before take-off: waiting for vehicles that are about to be ready."""
