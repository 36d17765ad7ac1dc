"""Trees that join the pins of a net, and the two-pin tasks along them."""
