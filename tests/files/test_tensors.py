import pytest
import torch

from mechsearch.files.tensors import (
    Archive,
    fill,
    fill_optimizer,
    load_archive,
    optimizer_tensors,
    part,
    prefixed,
    save_archive,
)
from mechsearch.types import MechSearchError


def test_parts_are_found_again_by_their_prefix():
    tensors = {**prefixed("a", {"x": torch.ones(1)}), **prefixed("ab", {"y": torch.zeros(1)})}
    assert list(part(tensors, "a")) == ["x"]
    assert list(part(tensors, "ab")) == ["y"]


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.uint8, torch.bool])
def test_tensors_and_facts_come_back(dtype, tmp_path):
    path = tmp_path / "file.safetensors"
    tensor = torch.arange(6).reshape(2, 3).to(dtype)
    save_archive(path, Archive("thing", {"t": tensor, "scalar": torch.tensor(2.0)}, {"n": [1, 2]}))
    found = load_archive(path, "thing")
    assert torch.equal(found.tensors["t"], tensor)
    assert found.tensors["scalar"].item() == 2.0
    assert found.meta == {"n": [1, 2]}


def test_a_file_of_another_kind_is_refused(tmp_path):
    save_archive(tmp_path / "x.safetensors", Archive("thing", {"t": torch.ones(1)}, {}))
    with pytest.raises(MechSearchError, match="holds a thing"):
        load_archive(tmp_path / "x.safetensors", "other")


def test_weights_of_another_shape_are_refused():
    layer = torch.nn.Linear(2, 3)
    with pytest.raises(MechSearchError, match=r"'weight' is \(3, 5\); expected \(3, 2\)"):
        fill(layer, torch.nn.Linear(5, 3).state_dict())
    with pytest.raises(MechSearchError, match="another network: bias"):
        fill(layer, {"weight": torch.ones(3, 2)})


def test_an_optimiser_goes_on_where_it_was():
    def stepped(layer, optimizer):
        optimizer.zero_grad()
        torch.autograd.backward(layer(torch.ones(1, 2)).square().sum())
        optimizer.step()

    torch.manual_seed(0)
    layer = torch.nn.Linear(2, 3)
    twin = torch.nn.Linear(2, 3)
    optimizers = [torch.optim.Adam(n.parameters(), 0.1, fused=True) for n in (layer, twin)]
    for _ in range(3):
        stepped(layer, optimizers[0])
    twin.load_state_dict(layer.state_dict())
    fill_optimizer(
        optimizers[1], {k: v.clone() for k, v in optimizer_tensors(optimizers[0]).items()}
    )
    stepped(layer, optimizers[0])
    stepped(twin, optimizers[1])
    assert torch.equal(layer.weight, twin.weight)
