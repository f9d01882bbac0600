"""The ports and devices of vehicle urls on this computer: whether they can be used, who holds them, who claims them."""
