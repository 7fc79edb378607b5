"""A multicopter that flies, obeys and speaks as an ArduCopter does."""
