"""What a colour means, in the plots and in the scene alike (R, G, B 0..255)."""

PHYSICAL = (255, 140, 38)  # the force that acts
MEASURED = (92, 168, 255)  # what the sensor gave
USED = (80, 214, 140)  # what drove the numerical model
DESIRED = (176, 182, 192)  # what the numerical model asks for
REACHED = (255, 140, 38)  # what the rig did
TRUE = (176, 182, 192)  # what an estimate should be
ESTIMATE = (196, 132, 255)
UNSURE = (196, 132, 255, 70)  # an estimate that still moves
ENERGY = (255, 92, 110)
PATH = (250, 214, 120)  # where the tip of the probe goes
TEXT = (235, 238, 242)
SERIES = ((92, 168, 255), (80, 214, 140), (255, 140, 38), (196, 132, 255), (255, 92, 110), (240, 210, 90))  # what has no meaning of its own
AXES = ((0.92, 0.26, 0.24, 1.0), (0.30, 0.78, 0.36, 1.0), (0.28, 0.52, 0.98, 1.0))  # x, y, z, 0..1
