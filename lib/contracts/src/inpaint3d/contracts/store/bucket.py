"""The store in a bucket (S3 or what speaks it), with the layout of `base`, and a local folder as its cache.

An artifact is there once its manifest is: files go up first, the manifest last. A key is committed by a conditional
put, so that of many pods computing one key a single result counts. Connections that break are tried again with
back-off; what an interrupted transfer has brought over whole is not moved twice. Every upload carries its sha256, and
whatever comes down is hashed before it is seen.

Where and who is told by the environment, as everywhere with S3: AWS_ENDPOINT_URL, AWS_REGION, AWS_ACCESS_KEY_ID,
AWS_SECRET_ACCESS_KEY, or a pod's own role. INPAINT3D_CACHE names the cache; buckets may share it, and it may be lost.
"""

import contextlib
import os
import secrets
import shutil
from collections.abc import Generator, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, PermissionDeniedError, UnauthenticatedError
from obstore.store import S3Store

from inpaint3d.contracts.errors import ArtifactError, ConfigurationError, RetryableError, StorageError
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import CHUNK, digest_of_chunks, file_digest
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest
from inpaint3d.contracts.store.artifact import find_folder_damage, hex_of, object_file
from inpaint3d.contracts.store.base import Store

client: Any = obstore  # its stubs name libraries that are not installed
CACHE = "INPAINT3D_CACHE"
PART = 8 << 20  # bytes of one part of a multipart upload; larger files are sent in such parts, four at a time
MAX_RETRIES = 6
GIVE_UP_AFTER = timedelta(seconds=120)

NO_BUCKET = "NoSuchBucket"
"""S3's own word, which the client library passes on in its text alone."""


class BucketStore(Store):
    """A store at `s3://BUCKET/PREFIX`. Locks hold within one machine; between machines the commit decides."""

    def __init__(self, place: str, cache: Path | None = None, *, retries: int = MAX_RETRIES) -> None:
        url = urlparse(place)
        if not url.netloc or url.username or url.query:
            raise ConfigurationError(
                f"--store {place}: write s3://BUCKET/PREFIX; credentials come from the environment"
            )
        super().__init__(cache or Path(os.environ.get(CACHE, "~/.cache/inpaint3d")).expanduser(), place.rstrip("/"))
        endpoint = os.environ.get("AWS_ENDPOINT_URL", "")
        with self._translate_errors():
            self._bucket = S3Store(
                url.netloc,
                prefix=url.path.strip("/") or None,
                checksum_algorithm="SHA256",
                client_options={"allow_http": endpoint.startswith("http://")},
                retry_config={"max_retries": retries, "retry_timeout": GIVE_UP_AFTER},
            )

    def read(self, path: str) -> bytes | None:
        with self._translate_errors():
            try:
                return bytes(client.get(self._bucket, path).bytes())
            except FileNotFoundError:
                return None

    def write(self, path: str, data: bytes) -> None:
        with self._translate_errors():
            client.put(self._bucket, path, data, use_multipart=False)

    def create(self, path: str, data: bytes) -> bool:
        with self._translate_errors():
            try:
                client.put(self._bucket, path, data, mode="create")
            except AlreadyExistsError:
                return False
        return True

    def retire(self, path: str) -> None:
        with self._translate_errors(), contextlib.suppress(FileNotFoundError):
            client.rename(self._bucket, path, f"quarantine/{secrets.token_hex(4)}/{Path(path).name}")

    def remove(self, path: str) -> None:
        with self._translate_errors(), contextlib.suppress(FileNotFoundError):
            client.delete(self._bucket, path)

    def names(self, folder: str) -> list[str]:
        with self._translate_errors():
            listed = client.list_with_delimiter(self._bucket, folder)
        paths = [*listed["common_prefixes"], *(entry["path"] for entry in listed["objects"])]
        return sorted(Path(path).name for path in paths)

    def fetch(self, digest: Digest) -> Path:
        """Its folder in the cache, fetched if need be. One that is damaged in the bucket is quarantined there."""
        folder = self.object_path(digest)
        with self.lock(digest):
            if find_folder_damage(folder, digest) is not None:
                shutil.rmtree(folder, ignore_errors=True)
                self._download(digest)
        return folder

    def find_damage(self, digest: Digest) -> str | None:
        """What is wrong with an artifact in the bucket (every byte is read), or None."""
        try:
            manifest = self.manifest(digest)
        except ArtifactError as error:
            return str(error)
        if difference := self._compare_listing(digest, manifest):
            return difference
        for entry in manifest.files:
            path = object_file(digest, entry.path)
            with self._translate_errors():
                found = digest_of_chunks(self._read_stream(path))
            if found != f"sha256:{entry.sha256}":
                return f"{self.place}/{path} is not what was written (sha256 differs)"
        return None

    def is_whole(self, digest: Digest) -> bool:
        """Whether the manifest is right and every file is there in its size. Bytes are hashed when they are fetched."""
        try:
            return self._compare_listing(digest, self.manifest(digest)) is None
        except ArtifactError:
            return False

    def is_present(self, digest: Digest) -> bool:
        return self.read(object_file(digest, MANIFEST)) is not None

    def size(self, digest: Digest) -> int:
        return sum(self._list_sizes(digest).values())

    def quarantine(self, digest: Digest) -> None:
        """Move an artifact out of sight, its manifest first, and forget the cached copy."""
        target = f"quarantine/{secrets.token_hex(4)}/{hex_of(digest)}"
        for path in sorted(self._list_sizes(digest), key=lambda p: p != MANIFEST):
            with self._translate_errors(), contextlib.suppress(FileNotFoundError):
                client.rename(self._bucket, object_file(digest, path), f"{target}/{path}")
        shutil.rmtree(self.object_path(digest), ignore_errors=True)

    def drop_object(self, digest: Digest) -> None:
        for path in sorted(self._list_sizes(digest), key=lambda p: p != MANIFEST):
            self.remove(object_file(digest, path))
        shutil.rmtree(self.object_path(digest), ignore_errors=True)

    def _publish(self, folder: Path, manifest: Manifest) -> Digest:
        digest = self.keep(folder, manifest)
        there = self._list_sizes(digest)
        local = self.object_path(digest)
        for entry in manifest.files:
            if there.get(entry.path) != entry.size:
                self._upload(local / entry.path, object_file(digest, entry.path))
        self._upload(local / MANIFEST, object_file(digest, MANIFEST))
        return digest

    def _upload(self, source: Path, path: str) -> None:
        with self._translate_errors():
            client.put(self._bucket, path, source, chunk_size=PART, max_concurrency=4)

    def _download(self, digest: Digest) -> None:
        """Bring an artifact into the cache. Files that an earlier try brought whole are not fetched again."""
        manifest = self.manifest(digest)
        if difference := self._compare_listing(digest, manifest):
            self._refuse(digest, difference)
        arriving = self.work_folder(digest)
        for entry in manifest.files:
            target, path = arriving / entry.path, object_file(digest, entry.path)
            if target.is_file() and file_digest(target) == f"sha256:{entry.sha256}":
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with self._translate_errors(), target.open("wb") as file:
                file.writelines(self._read_stream(path))
            if file_digest(target) != f"sha256:{entry.sha256}":
                self.drop_work(digest)
                self._refuse(digest, f"{self.place}/{path} is not what was written (sha256 differs)")
        self.keep(arriving, manifest)

    def _compare_listing(self, digest: Digest, manifest: Manifest) -> str | None:
        """What the bucket's listing says against the manifest, or None."""
        if manifest.digest != digest:
            return f"{self.place}/{object_file(digest, MANIFEST)} does not hash to {digest}"
        there = self._list_sizes(digest)
        for entry in manifest.files:
            if entry.path not in there:
                return f"{self.place}/{object_file(digest, entry.path)} is missing"
            if there[entry.path] != entry.size:
                return f"{self.place}/{object_file(digest, entry.path)} is not what was written (size differs)"
        if extra := set(there) - {f.path for f in manifest.files} - {MANIFEST}:
            return f"{self.place}/{object_file(digest, '')} holds files of nobody's: {sorted(extra)[:3]}"
        return None

    def _list_sizes(self, digest: Digest) -> dict[str, int]:
        """Relative path -> bytes of all that lies under a digest."""
        folder = f"objects/{hex_of(digest)}/"
        with self._translate_errors():
            pages = client.list(self._bucket, folder, chunk_size=1000)
            return {entry["path"].removeprefix(folder): entry["size"] for page in pages for entry in page}

    def _read_stream(self, path: str) -> Iterator[bytes]:
        return (bytes(chunk) for chunk in client.get(self._bucket, path).stream(CHUNK))

    @contextlib.contextmanager
    def _translate_errors(self) -> Generator[None]:
        """Give the client library's errors the tree's names."""
        try:
            yield
        except FileNotFoundError as error:
            raise StorageError(f"{self.place}: {_shorten(error)}; check the bucket's name") from error
        except (PermissionDeniedError, UnauthenticatedError) as error:
            raise StorageError(f"no access to {self.place} ({_shorten(error)}); check AWS_ACCESS_KEY_ID") from error
        except BaseError as error:
            if NO_BUCKET in str(error):
                raise StorageError(f"there is no bucket {self.place}; make it, or give another --store") from error
            raise RetryableError(f"{self.place} does not answer ({_shorten(error)}); run again") from error


def _shorten(error: Exception) -> str:
    return str(error).strip().splitlines()[0]
