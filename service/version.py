"""Version of the package; the build reads it from here.

The metadata of the installation are no substitute: an editable installation keeps those of the day it was made.
"""

VERSION = "1.0.0rc1"
