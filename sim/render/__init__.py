"""From the projector's light over surfaces and lens to the sensor's image, with the truth beside it."""
