"""A COLMAP model beside its pictures: `sparse/0/` or the largest of several, text or binary."""

from pathlib import Path

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.stages.capture_ingest.colmap_model import (
    ListedCamera,
    ListedImage,
    count_images,
    find_half,
    has_model,
    read_model,
)
from inpaint3d.stages.capture_ingest.found import (
    Found,
    FoundFrame,
    SourceFiles,
    find_subfolder,
    masks_for,
    name_pictures,
    numeric_order,
    one_folder,
)
from inpaint3d.stages.capture_ingest.lenses import StatedLens, fit_camera

MAX_QUATERNION = 1e100  # its square can still be told from infinity, and that of its inverse from 0
PICTURE_FOLDERS = ("images", "")


def model_folders(root: Path) -> list[Path]:
    """Where models lie: `sparse/0`, `sparse/1`, ..., `sparse`, or the top."""
    sparse = root / "sparse"
    numbered = sorted((p for p in sparse.iterdir() if p.is_dir()), key=numeric_order) if sparse.is_dir() else []
    return [folder for folder in (*numbered, sparse, root) if has_model(folder)]


def check_halves(root: Path) -> None:
    """BadInputError for a folder below `sparse/` with cameras and no images, or the other way round."""
    sparse = root / "sparse"
    for folder in [sparse, *(p for p in sparse.iterdir() if p.is_dir())] if sparse.is_dir() else []:
        if half := find_half(folder):
            raise BadInputError(
                f"{half.relative_to(root)} is half of a model; put cameras and images there, both .bin or both .txt, "
                "or remove it"
            )


def find(root: Path) -> Found:
    """The registered pictures with their cameras; BadInputError for a broken model or a missing picture."""
    folders = model_folders(root)
    if not folders:
        raise BadInputError("no cameras.bin or cameras.txt below sparse/; export the model there")
    sizes = {folder: count_images(folder) for folder in folders}
    folder = max(folders, key=sizes.__getitem__)  # the first of equals
    where = folder.relative_to(root).as_posix()
    cameras, images = read_model(folder, where)
    files = SourceFiles(root)
    paths = {image.number: _find_picture(files, image.name, where) for image in images}
    _check_once(images, paths, where)
    frames = _match_frames(root, paths, cameras, images, where)
    notes = files.notes(where)
    if len(folders) > 1:
        others = ", ".join(f"{f.relative_to(root).as_posix()} with {n}" for f, n in sizes.items() if f != folder)
        notes.append(f"{where} is taken, the model with most pictures ({sizes[folder]}); not {others}")
    return Found("colmap", frames, ordered=one_folder(frames), notes=notes)


def _find_picture(files: SourceFiles, name: str, where: str) -> Path:
    if path := files.find(name, where, below=PICTURE_FOLDERS):
        return path
    raise BadInputError(f"{where}: the model names {name}, which is not in images/; put the pictures there")


def _check_once(images: list[ListedImage], paths: dict[int, Path], where: str) -> None:
    first: dict[Path, ListedImage] = {}
    for image in images:
        if (other := first.setdefault(paths[image.number], image)) is not image:
            raise BadInputError(
                f"{where}: images {other.number} and {image.number} are both {image.name}; export the model again"
            )


def _match_frames(
    root: Path, paths: dict[int, Path], cameras: dict[int, ListedCamera], images: list[ListedImage], where: str
) -> list[FoundFrame]:
    names = name_pictures(list(paths.values()))
    masks = masks_for(list(paths.values()), find_subfolder(root, "masks"))
    frames: list[FoundFrame] = []
    for image in images:
        if image.camera not in cameras:
            raise BadInputError(
                f"{where}: {image.name} has the camera {image.camera}, which is not listed; export it again"
            )
        path = paths[image.number]
        camera = _convert_known(path, cameras[image.camera], image, where)
        frames.append(FoundFrame(names[path], path, masks.get(path), camera))
    return sorted(frames, key=lambda f: numeric_order(f.image))


def _convert_known(path: Path, camera: ListedCamera, image: ListedImage, where: str) -> KnownCamera:
    largest = max(map(abs, image.quaternion))
    if not 1 / MAX_QUATERNION < largest < MAX_QUATERNION or not np.isfinite(image.quaternion).all():
        raise BadInputError(f"{where}: {image.name} has the quaternion {list(image.quaternion)}; export it again")
    rotation = quaternion_matrix(image.quaternion)  # camera from world
    with np.errstate(all="ignore"):  # what is not finite is refused with the pose
        centre = -rotation.T @ np.array(image.translation)
    lens = StatedLens(camera.model, camera.params, (camera.width, camera.height))
    return fit_camera(path, lens, np.concatenate([rotation.T, centre[:, None]], 1), where)


def quaternion_matrix(q: tuple[float, ...]) -> np.ndarray:
    """Rotation [3, 3] of a quaternion (w, x, y, z)."""
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
