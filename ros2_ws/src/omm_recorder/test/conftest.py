"""The recordings that the tests are shown."""

from recorded_samples import bench, messages, python_environment, record, samples, topics  # noqa: F401
