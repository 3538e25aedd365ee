"""The motion platform: from the commanded relative pose to the one that the rig reaches."""
