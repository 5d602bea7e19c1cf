"""Version of the package; the build reads it from here.

Installed metadata are no substitute: an editable installation keeps the version of the day it was made.
"""

VERSION = "1.0.0rc1"
