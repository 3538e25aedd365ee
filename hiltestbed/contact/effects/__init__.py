"""Effects of the contact and of the sensor's frame."""
