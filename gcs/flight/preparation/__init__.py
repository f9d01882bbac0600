"""Before take-off: the speed that the computer can keep, the wait for ready vehicles, and the wait for the start."""
