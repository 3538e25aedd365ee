"""The meaning of the colours, in the plots and in the scene (R, G, B 0..255)."""

PHYSICAL = (255, 140, 38)  # the force that acts
MEASURED = (92, 168, 255)  # the sensor's reading
USED = (80, 214, 140)  # the force that drove the numerical model
DESIRED = (176, 182, 192)  # the pose commanded by the numerical model
REACHED = (255, 140, 38)  # the pose that the rig reached
TRUE = (176, 182, 192)  # the true value of an estimate
ESTIMATE = (196, 132, 255)
ENERGY = (255, 92, 110)
PATH = (250, 214, 120)  # the path of the probe's tip
TEXT = (235, 238, 242)
# curves without a fixed meaning
SERIES = (
    (92, 168, 255),
    (80, 214, 140),
    (255, 140, 38),
    (196, 132, 255),
    (255, 92, 110),
    (240, 210, 90),
)
AXES = ((0.92, 0.26, 0.24, 1.0), (0.30, 0.78, 0.36, 1.0), (0.28, 0.52, 0.98, 1.0))  # x, y, z, 0..1
