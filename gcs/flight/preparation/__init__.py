"""Before take-off: the speed that the computer holds, and the wait for vehicles that are about to be ready."""
