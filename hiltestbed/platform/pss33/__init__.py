"""The 3-3 PSS platform: six limbs, each a slider, a link and two spherical joints."""
