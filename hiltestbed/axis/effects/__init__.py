"""What a real axis does that its nominal model does not: a class an effect, in the file of what it
acts on.
"""
