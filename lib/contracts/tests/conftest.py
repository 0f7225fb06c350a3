from tests.s3 import bucket, network

__all__ = ["bucket", "network"]
