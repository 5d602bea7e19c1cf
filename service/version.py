"""Version of the package, from which the build takes it.

It is not read from the metadata of the installation: those of an editable one are as old as the installation.
"""

VERSION = "1.0.0rc1"
