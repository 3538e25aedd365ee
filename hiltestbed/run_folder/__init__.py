"""The run as it is returned and stored: folder, result, labelled data."""
