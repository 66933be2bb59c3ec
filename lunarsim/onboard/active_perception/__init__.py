"""Active perception: plan paths by the information that the sensors gain on them."""
