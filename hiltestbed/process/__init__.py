"""The process itself: interruption, progress, workers, the installation."""
