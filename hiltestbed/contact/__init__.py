"""The contact: mechanisms, contact geometry, force law, friction, latch and mount."""
