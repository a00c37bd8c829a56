"""From an encoded picture to what is in it: the one way that bin, `rodeo classify`, bench and oracle share.

`images` decodes what strangers send, within limits. `classification` is the answer and the data that decide
it, known by their hashes. `classifier` runs the network. OpenCV is imported where it is used: who only names
a hash or reads a picture's header needs none. Training is in `training/`.
"""
