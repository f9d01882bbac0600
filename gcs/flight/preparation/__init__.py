"""Before take-off: the speed that the computer holds, and the waits for vehicles to be ready and for a start."""
