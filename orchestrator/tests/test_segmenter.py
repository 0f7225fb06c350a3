"""Which network of the Segment Anything family two files are; those that are none, told before anything starts."""

from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper
from onnx.external_data_helper import convert_model_to_external_data

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import Segmenter
from inpaint3d.contracts.models.onnx_signature import read_onnx_signature
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.orchestrator.intake import take_segmenter
from inpaint3d.orchestrator.segmenter import recognise
from tests.sam_networks import KINDS, Kind, write_networks


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")


def write_signature(path: Path, inputs: dict[str, list], outputs: dict[str, list]) -> Path:
    """An ONNX file of these inputs and outputs that computes nothing."""
    given, wanted = (
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in values.items()]
        for values in (inputs, outputs)
    )
    onnx.save(helper.make_model(helper.make_graph([], "g", given, wanted)), path)
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_families_are_told_apart_by_their_files(store: Store, tmp_path: Path, kind: Kind) -> None:
    encoder, decoder = write_networks(tmp_path, kind)
    artifact = store.open(take_segmenter(store, encoder, decoder), Segmenter)
    assert artifact.metadata.family == ("sam" if kind.startswith("sam-") else kind)
    assert artifact.path(artifact.metadata.encoder).read_bytes() == encoder.read_bytes()
    assert artifact.path(artifact.metadata.decoder).read_bytes() == decoder.read_bytes()


def test_what_a_file_takes_and_gives_is_what_onnx_itself_says(tmp_path: Path) -> None:
    for kind in KINDS:
        for path in write_networks(tmp_path, kind):
            graph, found = onnx.load(path).graph, read_onnx_signature(path)
            for values, read in ((graph.input, found.inputs), (graph.output, found.outputs)):
                said = {v.name: tuple(d.dim_value or None for d in v.type.tensor_type.shape.dim) for v in values}
                assert said == read


def test_the_same_files_under_other_names_are_the_same_network(store: Store, tmp_path: Path) -> None:
    encoder, decoder = write_networks(tmp_path, "sam2")
    first = take_segmenter(store, encoder, decoder)
    assert take_segmenter(store, encoder.rename(tmp_path / "a.onnx"), decoder.rename(tmp_path / "b.onnx")) == first
    assert take_segmenter(store, *write_networks(tmp_path, "sam2", best=0)) != first


def test_files_that_fit_no_family_or_not_each_other_are_told(tmp_path: Path) -> None:
    encoder, decoder = write_networks(tmp_path, "sam")
    other, _ = write_networks(tmp_path, "sam2")
    with pytest.raises(ConfigurationError, match=r"sam\.encoder\.onnx is no decoder.*input_image \[1, 3, 64, 64\]"):
        recognise(decoder, encoder)
    with pytest.raises(ConfigurationError, match=r"sam2\.encoder\.onnx is not the encoder of .*high_res_feats_0"):
        recognise(other, decoder)
    hq = write_signature(
        tmp_path / "hq.onnx",
        {n: [1] for n in (*read_onnx_signature(decoder).inputs, "interm_embeddings")},
        {"masks": [1], "iou_predictions": [1]},
    )
    with pytest.raises(ConfigurationError, match=r"hq\.onnx is no decoder.*interm_embeddings.*wanted"):
        recognise(encoder, hq)


@pytest.mark.parametrize("content", [b"", b"not a network", b"\x80\x02}q\x00.", b"\x08\x09"], ids=repr)
def test_files_that_are_no_onnx_are_told(tmp_path: Path, content: bytes) -> None:
    encoder, decoder = write_networks(tmp_path, "sam")
    encoder.write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"--segmenter .*sam\.encoder\.onnx: "):
        recognise(encoder, decoder)
    with pytest.raises(ConfigurationError, match=r"nowhere\.onnx cannot be read \(No such file"):
        recognise(tmp_path / "nowhere.onnx", decoder)


def test_half_a_file_is_told(tmp_path: Path) -> None:
    encoder, decoder = write_networks(tmp_path, "sam")
    decoder.write_bytes(decoder.read_bytes()[:-40])
    with pytest.raises(ConfigurationError, match=r"sam\.decoder\.onnx: no ONNX file, or not all of it"):
        recognise(encoder, decoder)


def move_weights(decoder: Path, location: str) -> None:
    model = onnx.load(decoder)
    convert_model_to_external_data(model, location=location, size_threshold=0)
    onnx.save(model, decoder)


def test_weights_in_a_file_of_their_own_are_taken_too(store: Store, tmp_path: Path) -> None:
    encoder, decoder = write_networks(tmp_path, "sam")
    move_weights(decoder, "weights.bin")
    artifact = store.open(take_segmenter(store, encoder, decoder), Segmenter)
    assert (artifact.root / "decoder" / "weights.bin").read_bytes() == (tmp_path / "weights.bin").read_bytes()
    (tmp_path / "weights.bin").unlink()
    with pytest.raises(ConfigurationError, match=r"weights are said to lie in 'weights\.bin', which is no file beside"):
        recognise(encoder, decoder)


def test_weights_are_taken_from_beside_the_file_alone(tmp_path: Path) -> None:
    encoder, decoder = write_networks(tmp_path, "sam")
    move_weights(decoder, "___weights.bin")
    (tmp_path.parent / "weights.bin").write_bytes(b"somebody else's")
    for elsewhere in (b"../weights.bin", b"/__weights.bin", b"sub/weight.bin"):
        spoilt = tmp_path / "spoilt.onnx"
        spoilt.write_bytes(decoder.read_bytes().replace(b"___weights.bin", elsewhere))
        with pytest.raises(ConfigurationError, match="which is no file beside it"):
            recognise(encoder, spoilt)
