"""A measuring session: images and spindle poses in, the result out."""
