"""The shipped platforms, one file each: the settings in a scenario, and the facility that they
describe.
"""
