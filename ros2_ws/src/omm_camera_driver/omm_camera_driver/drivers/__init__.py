"""One folder a kind of camera, behind the small interface of `driver`."""
