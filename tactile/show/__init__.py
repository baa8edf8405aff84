"""What people look at: a live picture in a terminal, still pictures of textures, and plots.

`live` is the picture while something plays, `views` the arrays of a still picture of a texture,
which `still` draws in a terminal and `plots` to files.
"""
