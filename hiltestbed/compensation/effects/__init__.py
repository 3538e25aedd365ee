"""Effects between the measured wrench and the compensated wrench."""
