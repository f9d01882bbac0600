"""The ports and devices of vehicle urls on this computer: whether they are usable, and which process holds them."""
