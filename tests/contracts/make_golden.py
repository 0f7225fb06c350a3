"""Write golden instances of schema versions that have none yet, and a store: `python -m tests.contracts.make_golden`.

The instances are what the stubs write. What is there is never touched: it stands for the data that exist out there.
"""

import tempfile
from pathlib import Path

from inpaint3d.contracts.kit.upstream import Upstream, invoke
from inpaint3d.contracts.models.artifacts import DiffusersPipeline, ImageCorpus, PaintedView, PaintedViews, Segmenter
from inpaint3d.contracts.models.manifest import MANIFEST
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.contracts.store.workspace import remove
from tests.conftest import REPOSITORY
from tests.faults.trials import build_store

STORE = REPOSITORY / "tests" / "contracts" / "golden_store"
"""Results, and the record of the run that made them, as a version of ours has kept them."""


def main() -> None:
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    with tempfile.TemporaryDirectory() as folder:
        store = FolderStore(Path(folder))
        for last in (node for node in pipeline.order if not pipeline.downstream(node)):
            upstream = Upstream(pipeline, last, store)
            result = invoke(pipeline.stages[last], store, upstream.inputs_of(last), stub=True)
            given = (_corpus(store), _pipeline(store), _painted(store), _segmenter(store))
            for digest in (*upstream.produced.values(), *result.outputs.values(), *given):
                name, _, version = store.manifest(digest).schema_id.partition("@")
                target = REPOSITORY / "schemas" / "golden" / name / f"{version}.json"
                if not target.exists():
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes((store.object_path(digest) / MANIFEST).read_bytes())
    if not STORE.exists():
        build_store(STORE)
        remove(STORE / "locks")


def _corpus(store: Store) -> str:
    folder = store.private_folder()
    (folder / "images").mkdir()
    (folder / "images" / "a.jpg").write_bytes(b"not looked at")
    picture = ImageCorpus.Picture(name="a", path="images/a.jpg", scene="a", split="train")
    return store.put(folder, "image-corpus", ImageCorpus(pictures=(picture,)))


def _pipeline(store: Store) -> str:
    folder = store.private_folder()
    (folder / "pipeline").mkdir()
    (folder / "pipeline" / "model_index.json").write_text('{"_class_name": "StableDiffusionInpaintPipeline"}')
    return store.put(folder, "diffusers-pipeline", DiffusersPipeline(kind="StableDiffusionInpaintPipeline"))


def _painted(store: Store) -> str:
    folder = store.private_folder()
    for name in ("pictures", "masks"):
        (folder / name).mkdir()
        (folder / name / "a.png").write_bytes(b"not looked at")
    view = PaintedView(name="a", picture="pictures/a.png", mask="masks/a.png")
    return store.put(folder, "painted-views", PaintedViews(views=(view,)))


def _segmenter(store: Store) -> str:
    folder, metadata = store.private_folder(), Segmenter(family="sam")
    for path in (metadata.encoder, metadata.decoder):
        (folder / path).parent.mkdir()
        (folder / path).write_bytes(b"not looked at")
    return store.put(folder, "segmenter", metadata)


if __name__ == "__main__":
    main()
