"""The report of a diagnosis: what follows from the finding, and how it is shown."""
