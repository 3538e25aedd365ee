"""Campaigns: a design over scenario keys, run in chunks on one machine or many; finished chunks
survive any interruption.
"""
