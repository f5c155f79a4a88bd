"""What a description says of an exported network, beside the network itself."""

import pytest

_DTYPES = {"bool": "tensor(bool)", "float16": "tensor(float16)", "float32": "tensor(float)"}


def check_described(description, file, **lengths):
    """Names, dtypes and shapes are the network's own, and there are units; N stays open.

    Args:
        description: An `Exported`.
        file: The network.
        lengths: What other letters of a shape stand for.
    """
    onnxruntime = pytest.importorskip("onnxruntime")
    session = onnxruntime.InferenceSession(str(file))
    for said, own in (
        (description.inputs, session.get_inputs()),
        (description.outputs, session.get_outputs()),
    ):
        assert set(said) == {tensor.name for tensor in own}
        for tensor in own:
            told = said[tensor.name]
            assert tensor.type == _DTYPES[told["dtype"]]
            assert len(tensor.shape) == len(told["shape"])
            for side, meant in zip(tensor.shape, told["shape"], strict=True):
                assert isinstance(side, str) if meant == "N" else side == lengths.get(meant, meant)
            assert told["unit"]
