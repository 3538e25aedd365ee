"""What a user, a disk or a bad day does to the tool, tried at random: `hiltestbed bench robustness`."""
