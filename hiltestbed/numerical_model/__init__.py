"""The numerical model: two free-flying spacecraft, driven by the compensated wrench."""
