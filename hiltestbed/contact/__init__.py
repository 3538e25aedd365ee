"""The contact: mechanisms, where they touch, the force law between them, friction, latch and mount."""
