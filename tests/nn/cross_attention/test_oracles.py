"""The mechanisms against PyTorch, transformers and loops in NumPy (§7): random parameters, padded scenes, float64."""

from __future__ import annotations

from fractions import Fraction as F

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.cross_attention import ContextSpec, from_name
from scjax.nn.cross_attention.deformable import ring_offsets
from scjax.nn.functional import flatten
from tests.factories import golden
from tests.factories.attention_cases import HEADS, IMAGE, KEYS, TEXT, WIDTH, apply, call, params_of, scenes

torch = pytest.importorskip("torch", reason="the parity extra (torch, transformers) is not installed")
functional = torch.nn.functional

SIZE, TOLERANCE = WIDTH // HEADS, 1e-9


def _ours(options, params, batch, spec=TEXT, heads=HEADS):
    """y, and the gradients of sum(sin(y)) by (parameters, x, context)."""
    x, x_mask, context, mask = batch

    def loss(params, x, context):
        y, _ = apply(options, params, x, x_mask, context, mask, spec=spec, heads=heads)
        return jnp.sin(y).sum(), y

    with jax.enable_x64(True):
        (_, y), gradients = golden.jit(jax.value_and_grad(loss, (0, 1, 2), has_aux=True))(params, x, context)
        return jax.device_get((y, gradients))


def _value(options, params, batch, spec=TEXT, heads=HEADS):
    """y alone."""
    with jax.enable_x64(True):
        return jax.device_get(call(options, params, *batch, spec=spec, heads=heads)[0])


def _compare(name, ours, theirs, params, x, context):
    """Values, and gradients by x, context and every parameter (torch tensors that require them)."""
    y, (of_params, of_x, of_context) = ours
    theirs.sin().sum().backward()
    pairs = {"y": (y, theirs), "x": (of_x, x.grad), "context": (of_context, context.grad)}
    pairs |= {"/".join(map(str, path)): (of_params, path, params) for path in flatten(params)}
    worst = 0.0
    for what, pair in pairs.items():
        if len(pair) == 3:
            mine, other = flatten(pair[0])[pair[1]], flatten(pair[2])[pair[1]].grad
            other = torch.zeros(mine.shape) if other is None else other
        else:
            mine, other = pair
        other = other.detach().numpy()
        error = np.abs(mine - other).max() / max(1.0, np.abs(other).max())
        assert error < TOLERANCE, f"{what}: {error:.1e}"
        worst = max(worst, error)
    print(f"{name}: y, x, context and {len(pairs) - 3} parameters, largest error {worst:.1e}")


def _tensors(tree):
    return jax.tree.map(lambda leaf: torch.tensor(np.asarray(leaf), dtype=torch.float64, requires_grad=True), tree)


def _linear(params, x):
    return x @ params["kernel"] + params["bias"]


def _norm(params, x):
    return functional.layer_norm(x, x.shape[-1:], params["scale"], params["bias"], 1e-5)


def _heads(x):
    return x.unflatten(-1, (HEADS, -1)).transpose(1, 2)


def _attention(params, query, context, admitted):
    """Projections, norms, and PyTorch's attention; ``admitted`` [b, 1 or h, n or 1, m]."""
    key, value = _norm(params["k_norm"], _linear(params["k"], context)), _linear(params["v"], context)
    return _sdpa(query, key, value, admitted)


def _sdpa(query, key, value, admitted=None):
    query, key, value = (_heads(a) for a in (query, key, value))
    return functional.scaled_dot_product_attention(query, key, value, attn_mask=admitted).transpose(1, 2).flatten(2)


def _finished(params, attended, rows):
    return torch.where(torch.tensor(rows)[..., None], _linear(params["out"], attended), 0.0)


def _query(params, x):
    return _norm(params["q_norm"], _linear(params["q"], x))


@pytest.mark.parametrize("fields", [{}, {"inner_ratio": 2}, {"chunk": 3}])
def test_full(fields):
    options, batch = from_name("full", **fields), scenes()
    params, (x, context) = params_of(options), _tensors((batch[0], batch[2]))
    theirs = _tensors(params)
    attended = _attention(theirs, _query(theirs, x), context, torch.tensor(batch[3])[:, None, None])
    y = _finished(theirs, attended, batch[1])
    _compare(f"full {fields}", _ours(options, params, batch), y, theirs, x, context)


def _window(n, m, window, alignment):
    """Which of m keys each of n queries reads, one by one, in exact arithmetic."""
    admitted = np.zeros((n, m), bool)
    for i in range(n):
        centre = F(i + m - n) if alignment == "fa2" else F(2 * i + 1, 2) * F(m, n) - F(1, 2)
        if alignment == "diagonal_rev":
            centre = m - 1 - centre
        for j in range(m):
            admitted[i, j] = abs(j - centre) <= window
    return admitted


@pytest.mark.parametrize("alignment", ["diagonal", "diagonal_rev", "fa2"])
@pytest.mark.parametrize("kind", ["text", "image"])
def test_windowed(alignment, kind):
    spec, window = (TEXT, 2) if kind == "text" else (IMAGE, 1)
    options, batch = from_name("windowed", window=window, alignment=alignment), scenes(spec)
    params, (x, context) = params_of(options, spec), _tensors((batch[0], batch[2]))
    theirs, admitted = _tensors(params), np.zeros((2, 6, KEYS), bool)
    cells = KEYS // spec.modalities
    for scene, (rows, keys) in enumerate(zip(batch[1], batch[3], strict=True)):
        for start in range(0, KEYS, cells):
            count = keys[start : start + cells].sum()
            found = _window(rows.sum(), count, window, alignment)
            admitted[scene, : rows.sum(), start : start + count] = found
    attended = _attention(theirs, _query(theirs, x), context, torch.tensor(admitted)[:, None])
    y = _finished(theirs, attended, batch[1] & admitted.any(-1))
    assert 0.2 < admitted[0, :4].mean() < 0.7
    _compare(f"windowed {kind} {alignment}", _ours(options, params, batch, spec), y, theirs, x, context)


def test_flash_attention_reaches_no_real_token_of_a_padded_prompt():
    """The specification's finding: 161 queries, 120 tokens padded to 512, at most 128 to each side."""
    assert not _window(161, 512, 128, "fa2")[:, :120].any()
    assert _window(161, 512, 256, "fa2")[:, :120].any()


def test_agent():
    """PyTorch's adaptive pooling of each scene's queries, and its attention twice."""
    options, batch = from_name("agent", tokens=3), scenes()
    params, (x, context) = params_of(options), _tensors((batch[0], batch[2]))
    theirs = _tensors(params)
    query, readable = _query(theirs, x), torch.tensor(batch[3])[:, None, None]
    pooled = [
        functional.adaptive_avg_pool1d(q[torch.tensor(rows)].T[None], 3)[0].T
        for q, rows in zip(query, batch[1], strict=True)
    ]
    agents = torch.stack(pooled)
    y = _finished(theirs, _sdpa(query, agents, _attention(theirs, agents, context, readable)), batch[1])
    _compare("agent", _ours(options, params, batch), y, theirs, x, context)


def test_gated_is_the_cross_attention_layer_of_mllama():
    """Its norms are by head and without mean, so: one head, centred projections. Its first norm is one that the
    tokens already have; its MLP is shut.
    """
    transformers = pytest.importorskip("transformers")
    from transformers.models.mllama.modeling_mllama import MllamaCrossAttentionDecoderLayer

    options, (x, x_mask, context, mask) = from_name("gated"), scenes()
    x = x / np.sqrt(np.square(x).mean(-1, keepdims=True) + ~x_mask[..., None])
    zero, params = np.zeros(WIDTH), params_of(options, heads=1)
    params = {**params, **{n: {"kernel": params[n]["kernel"], "bias": zero} for n in ("q", "k", "v", "out")}}
    for name in ("q", "k"):
        kernel = params[name]["kernel"]
        params[name] = {"kernel": kernel - kernel.mean(1, keepdims=True), "bias": zero}
        params[f"{name}_norm"] = {"scale": params[f"{name}_norm"]["scale"], "bias": zero}
    config = transformers.MllamaConfig(
        text_config={
            "hidden_size": WIDTH,
            "num_attention_heads": 1,
            "num_key_value_heads": 1,
            "rms_norm_eps": 1e-5,
            "num_hidden_layers": 1,
            "intermediate_size": 8,
            "cross_attention_layers": [0],
        }
    ).text_config
    config._attn_implementation = "eager"
    layer = MllamaCrossAttentionDecoderLayer(config, 0).double()
    layer.input_layernorm.variance_epsilon = 0.0
    attention = layer.cross_attn
    pairs = [(getattr(attention, f"{n[0]}_proj").weight, params[n]["kernel"].T) for n in ("q", "k", "v", "out")]
    pairs += [(getattr(attention, n).weight, params[n]["scale"]) for n in ("q_norm", "k_norm")]
    with torch.no_grad():
        for weight, value in [*pairs, (layer.cross_attn_attn_gate, params["gate"])]:
            weight.copy_(torch.tensor(value))
        x_t, context_t = torch.tensor(x), torch.tensor(context)
        refused = torch.where(torch.tensor(mask)[:, None, None], 0.0, -1e30).double().expand(2, 1, x.shape[1], KEYS)
        theirs = layer(x_t, context_t, refused, None, None) - x_t
    y = _value(options, params, (x, x_mask, context, mask), heads=1)
    error = np.abs((y - theirs.numpy())[x_mask]).max()
    print(f"gated against mllama: largest error {error:.1e}")
    assert error < 1e-6  # its norms compute in float32


def _by_kernel_matrix(params, batch, values, power):
    """Linear attention by its kernel, query by query and key by key, by the released formula for the features."""
    x, x_mask, context, mask = batch

    def project(name, x):
        return x @ params[name]["kernel"] + params[name]["bias"]

    def features(z):
        u = (np.maximum(z, 0) + 1e-6) / np.log1p(np.exp(params["sigma"]))
        return u**power * np.linalg.norm(u) / np.linalg.norm(u**power)

    y = np.zeros_like(x)
    for scene in range(2):
        keys = [features(project("k", token)) for token in context[scene][mask[scene]]]
        for i in np.flatnonzero(x_mask[scene]):
            query, heads = features(project("q", x[scene, i])), []
            for part in np.split(np.arange(WIDTH), HEADS):
                kernel = np.array([query[part] @ key[part] for key in keys]) / len(keys)
                heads.append(kernel @ values[scene][mask[scene]][:, part] / (kernel.sum() + 1e-6))
            y[scene, i] = project("out", np.concatenate(heads))
    return y


@pytest.mark.parametrize("power", [1, 3])
def test_linear(power):
    options, batch = from_name("linear", power=power), scenes()
    params = params_of(options)
    values = batch[2] @ params["v"]["kernel"] + params["v"]["bias"]
    error = np.abs(_value(options, params, batch) - _by_kernel_matrix(params, batch, values, power)).max()
    print(f"linear, power {power}: largest error {error:.1e}")
    assert error < TOLERANCE


@pytest.mark.parametrize("kind", ["text", "image"])
def test_convolution_of_values(kind):
    """PyTorch's depthwise convolution of the values, then the explicit kernel."""
    spec = TEXT if kind == "text" else IMAGE
    options, batch = from_name("linear", dwc="value"), scenes(spec)
    params = params_of(options, spec)
    values = (batch[2] @ params["v"]["kernel"] + params["v"]["bias"]) * batch[3][..., None]
    cells = torch.tensor(values.reshape(2, spec.modalities, -1, HEADS, SIZE)).permute(0, 1, 3, 4, 2).flatten(0, 2)
    kernel = torch.tensor(np.moveaxis(params["dwc"], -1, 0)[:, None])
    if kind == "text":
        near = functional.conv1d(cells, kernel, padding=2, groups=SIZE)
    else:
        near = functional.conv2d(cells.unflatten(-1, spec.grid), kernel, padding=2, groups=SIZE).flatten(2)
    near = near.unflatten(0, (2, spec.modalities, HEADS)).permute(0, 1, 4, 2, 3).reshape(values.shape).numpy()
    expected = _by_kernel_matrix(params, batch, values + near, 3)
    error = np.abs(_value(options, params, batch, spec) - expected).max()
    print(f"convolution of values, {kind}: largest error {error:.1e}")
    assert error < TOLERANCE and np.abs(near).max() > 0.1


def test_deformable_is_the_module_of_deformable_detr():
    pytest.importorskip("transformers")
    from transformers import DeformableDetrConfig
    from transformers.models.deformable_detr.modeling_deformable_detr import DeformableDetrMultiscaleDeformableAttention

    spec = ContextSpec(kind="image", grid=(2, 4), modalities=2)
    rng = np.random.default_rng(0)
    x, context = rng.normal(size=(2, 6, WIDTH)), rng.normal(size=(2, 16, WIDTH))
    x_mask, mask = scenes()[1], rng.random((2, 16)) < 0.8
    options = from_name("deformable", points=3)
    params = params_of(options, spec)
    config = DeformableDetrConfig(d_model=WIDTH, num_feature_levels=2, disable_custom_kernels=True)
    layer = DeformableDetrMultiscaleDeformableAttention(config, HEADS, 3).double()
    names = {"v": "value_proj", "out": "output_proj", "offsets": "sampling_offsets", "weights": "attention_weights"}
    with torch.no_grad():
        for ours, theirs in names.items():
            getattr(layer, theirs).weight.copy_(torch.tensor(params[ours]["kernel"].T))
            getattr(layer, theirs).bias.copy_(torch.tensor(params[ours]["bias"]))
    x_t, context_t, reference = _tensors(x), _tensors(context), _tensors(params["reference"])
    place = torch.sigmoid(_linear(reference, x_t))[:, :, None].expand(-1, -1, 2, -1)
    levels = {"spatial_shapes_list": [(2, 4)] * 2, "level_start_index": torch.tensor([0, 8])}
    levels["spatial_shapes"] = torch.tensor(levels["spatial_shapes_list"])
    theirs, _ = layer(
        x_t,
        torch.tensor(mask),
        context_t,
        reference_points=place,
        **levels,
    )
    theirs = torch.where(torch.tensor(x_mask)[..., None], theirs, 0.0)
    y, (of_params, of_x, of_context) = _ours(options, params, (x, x_mask, context, mask), spec)
    theirs.sin().sum().backward()
    pairs = {"y": (y, theirs), "x": (of_x, x_t.grad), "context": (of_context, context_t.grad)}
    for ours, theirs in names.items():
        pairs |= {f"{ours} kernel": (of_params[ours]["kernel"], getattr(layer, theirs).weight.grad.T)}
        pairs |= {f"{ours} bias": (of_params[ours]["bias"], getattr(layer, theirs).bias.grad)}
    pairs |= {f"reference {name}": (of_params["reference"][name], reference[name].grad) for name in reference}
    errors = {name: np.abs(mine - theirs.detach().numpy()).max() for name, (mine, theirs) in pairs.items()}
    print(f"deformable: y, x, context and 10 parameters, largest error {max(errors.values()):.1e}")
    assert max(errors.values()) < TOLERANCE, errors


def test_initial_offsets_are_those_of_deformable_detr():
    """Its rule, for 8 heads: the compass directions, a step further each point."""
    offsets = ring_offsets(8, 2, 3, 2).reshape(8, 2, 3, 2)
    compass = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]])
    np.testing.assert_allclose(
        offsets, compass[:, None, None] * np.array([1, 2, 3])[:, None] * np.ones((2, 1, 1)), atol=1e-6
    )
    assert ring_offsets(4, 1, 2, 1).tolist() == [1, 2, -1, -2, 1, 2, -1, -2]


def _softmax(logits):
    p = np.exp(logits - logits.max())
    return p / p.sum()


def _one_by_one(params, batch, choose):
    """Attention in loops; ``choose(head, queries, keys)`` tells the keys that each query of a scene reads."""
    x, x_mask, context, mask = batch

    def project(name, x):
        return x @ params[name]["kernel"] + params[name]["bias"]

    def norm(name, x):
        x = x - x.mean(-1, keepdims=True)
        x = x / np.sqrt(np.square(x).mean(-1, keepdims=True) + 1e-5)
        return x * params[name]["scale"] + params[name]["bias"]

    y, share = np.zeros_like(x), []
    for scene in range(2):
        tokens, rows = context[scene][mask[scene]], np.flatnonzero(x_mask[scene])
        queries, keys = norm("q_norm", project("q", x[scene][rows])), norm("k_norm", project("k", tokens))
        values, attended = project("v", tokens), np.zeros((len(rows), WIDTH))
        for head, part in enumerate(np.split(np.arange(WIDTH), HEADS)):
            chosen = choose(head, queries[:, part], keys[:, part])
            share.append(chosen.mean())
            for i in range(len(rows)):
                kept = keys[chosen[i]][:, part]
                attended[i, part] = _softmax(kept @ queries[i, part] / np.sqrt(SIZE)) @ values[chosen[i]][:, part]
        y[scene, rows] = project("out", attended)
    return y, np.mean(share)


def _unit(x):
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def test_saap():
    """Nearest centroid by angle; the classifier's two best buckets among those that hold a key."""
    options, batch = from_name("saap", buckets=5, probes=2), scenes()
    params = params_of(options)

    def choose(head, queries, keys):
        label = (_unit(keys) @ _unit(params["centroids"][head]).T).argmax(-1)
        router = params["router"]
        hidden = queries @ router["up"][head] + router["up_bias"][head]
        logits = hidden / (1 + np.exp(-hidden)) @ router["down"][head] + router["down_bias"][head]
        logits[:, ~np.isin(np.arange(5), label)] = -np.inf
        best = np.argsort(-logits, -1)[:, :2]
        return np.stack([np.isin(label, row) for row in best])

    expected, share = _one_by_one(params, batch, choose)
    y = _value(options, params, batch)
    print(f"saap: {share:.2f} of the keys, largest error {np.abs(y - expected).max():.1e}")
    assert 0.2 < share < 0.9 and np.abs(y - expected).max() < TOLERANCE


def _kmeans(keys, count, iterations):
    """Farthest-first, then Lloyd's steps by angle."""
    points = _unit(keys)
    chosen = [np.argmin(points @ _unit(points.sum(0)))]
    for _ in range(count - 1):
        chosen.append(np.argmin((points @ points[chosen].T).max(-1)))
    centres = points[chosen]
    for _ in range(iterations):
        label = (points @ centres.T).argmax(-1)
        for c in set(label):
            centres[c] = _unit(points[label == c].sum(0))
    return (points @ centres.T).argmax(-1)


@pytest.mark.parametrize("pool", ["mean", "none"])
def test_squeezed(pool):
    """Shares of clusters by their mean keys; a threshold on the length-normalised share, and always the best."""
    options, batch = from_name("squeezed", clusters=3, iterations=4, pool=pool), scenes()
    params = params_of(options)

    def choose(head, queries, keys):
        label = _kmeans(keys, 3, 4)
        size = np.bincount(label, minlength=3)
        mean = np.stack([keys[label == c].mean(0) if size[c] else np.zeros(SIZE) for c in range(3)])
        p = np.where(size > 0, np.exp(queries @ mean.T / np.sqrt(SIZE)), 0)
        shares = p / (p @ size)[:, None]
        np.testing.assert_allclose(shares @ size, 1)
        shares = shares.mean(0, keepdims=True) if pool == "mean" else shares
        best = shares.argmax(-1)[:, None] == np.arange(3)
        kept = (len(keys) * shares > params["threshold"]) | best
        return np.broadcast_to(kept[:, label], (len(queries), len(keys)))

    expected, share = _one_by_one(params, batch, choose)
    y = _value(options, params, batch)
    print(f"squeezed {pool}: {share:.2f} of the keys, largest error {np.abs(y - expected).max():.1e}")
    assert 0.2 < share < 0.9 and np.abs(y - expected).max() < TOLERANCE
