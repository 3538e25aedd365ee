"""Effects between the measured wrench and the one that is used."""
