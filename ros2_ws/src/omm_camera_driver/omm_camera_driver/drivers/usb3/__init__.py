"""USB3 Vision: which cameras are plugged in, and the link to one of them."""
