"""The released PyTorch code on the workload. Runs under the Python that has torch, without scjax or JAX.

    PYTHON benchmarks/peer/release.py FOLDER JOB

JOB is the JSON text that ``benchmarks.peer`` writes. The worker builds the release's own modules with random weights,
prints {"ready": ...}, and answers each line "go" with the seconds of one pass, and "end" with its peak memory.

Three things are replaced, since they need a GPU, data or weights: flash attention by PyTorch's own attention, the text
encoder and the data sets by nothing (features are given).
"""

from __future__ import annotations

import contextlib
import json
import resource
import sys
import time
import types

import torch

TEXT_TOKENS = 512
TEXT_WIDTH = 4096
RELEASE_STEPS = 100


class Config(dict):
    """Nested settings with attribute access, as the release's configuration files give them."""

    def __getattr__(self, name):
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None


def main(folder, job):
    """Builds the work of ``job`` and answers on standard output."""
    torch.set_num_threads(job["threads"])
    torch.manual_seed(0)
    sys.path.insert(0, folder)
    replace_missing_modules()
    start = time.perf_counter()
    run = {"train": training, "sample": sampling}[job["work"]](job)
    run()  # the first pass is not timed
    say({"ready": True, "compile_s": 0.0, "first_pass_s": time.perf_counter() - start, "roofline": roofline(job)})
    for line in sys.stdin:
        if line.strip() == "end":
            break
        start = time.perf_counter()
        scale = run()
        say({"seconds": (time.perf_counter() - start) * scale})
    say({"peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, "torch": torch.__version__})


def say(answer):
    """One answer to the driver."""
    print(json.dumps(answer), flush=True)


def replace_missing_modules():
    """Stands in for modules that the timed code imports and never uses, and for flash attention."""
    unused = {
        "datasets.waymo.dataset_ldm_waymo": ["WaymoDatasetLDM"],
        "datasets.nuplan.dataset_ldm_nuplan": ["NuplanDatasetLDM"],
        "nn_modules.text_encoders.umt5": ["T5EncoderModel"],
        "models.scenario_control_autoencoder": ["ScenarioControlAutoEncoder"],
    }
    for name, values in unused.items():
        module = types.ModuleType(name)
        for value in values:
            setattr(module, value, type(value, (), {}))
        sys.modules[name] = module
    import utils.attention_layers as attention_layers

    attention_layers.flash_attention = attention


def attention(q, k, v, q_lens=None, dropout_p=0.0, softmax_scale=None, unflatten=True, **_):
    """PyTorch's attention with the arguments of the release's flash attention.

    Without ``unflatten`` the result has the queries of all scenes in one axis, the first ``q_lens`` of each.
    """
    out = torch.nn.functional.scaled_dot_product_attention(
        q.transpose(1, 2), k.transpose(1, 2), v.transpose(1, 2), dropout_p=dropout_p, scale=softmax_scale
    ).transpose(1, 2)
    return out if unflatten else out[torch.arange(out.shape[1])[None] < torch.as_tensor(q_lens)[:, None]]


def training(job):
    """One optimizer step after another, as the release takes them; the denoiser with its moving average."""
    if job["kind"] == "autoencoder":
        from nn_modules.autoencoder import AutoEncoder

        model, average = AutoEncoder(autoencoder_config(job)), None
    else:
        model = denoiser(job)
        average = [parameter.detach().clone() for parameter in model.parameters()]
    model.train()
    decayed, other = [], []
    for name, parameter in model.named_parameters():
        if parameter.requires_grad:
            (decayed if name.endswith("weight") and parameter.dim() > 1 else other).append(parameter)
    optimizer = torch.optim.AdamW(
        [{"params": decayed, "weight_decay": 1e-5}, {"params": other, "weight_decay": 0.0}], lr=1e-4, eps=1e-7
    )
    batches = [make_batch(job, scenes) for scenes in job["parts"]]

    def run():
        for data in batches:
            optimizer.zero_grad(set_to_none=True)
            with precision(job):
                loss = model.loss(data)["loss"]
            loss.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 10.0)
            optimizer.step()
            if average is not None:
                with torch.no_grad():
                    torch._foreach_lerp_(average, [p.detach() for p in model.parameters()], 1e-4)
        return 1.0

    return run


def sampling(job):
    """Guided ancestral sampling of latents. A part of the equal steps is timed; the result is scaled to all."""
    model = denoiser(job).eval()
    model.n_timesteps = job["release_steps"]
    batches = [make_batch(job, scenes) for scenes in job["parts"]]

    def run():
        for data in batches:
            with torch.no_grad(), precision(job):
                model(data)
        return RELEASE_STEPS / model.n_timesteps

    return run


def precision(job):
    """Automatic mixed precision, as the release's trainer sets it, or nothing."""
    if job["compute"] == "bfloat16":
        return torch.autocast("cpu", torch.bfloat16)
    return contextlib.nullcontext()


def denoiser(job):
    """The release's latent diffusion model."""
    from nn_modules.ldm import LDM

    sizes, kind = job["sizes"], job["kind"]
    model = {
        **sizes,
        "dropout": 0,
        "label_dropout": 0.1,
        "num_scene_types": 3,
        "n_diffusion_timesteps": RELEASE_STEPS,
        "lane_sampling_temperature": 0.75,
        "diffusion_clip": 5,
        "img_conditioning": kind == "image",
        "dino_feat_channels": 384,
        "dino_patch_size": 16,
        "dino_dim_h": 14,
        "dino_dim_w": 14,
        "text_conditioning": kind == "text",
        "text_feat_dim": TEXT_WIDTH,
        "decode_in_training": False,
    }
    config = Config(
        model=Config(model),
        dataset=Config(num_map_ids=4, max_num_agents=61, max_num_lanes=100, use_cached_text_embeds=True),
        train=Config(
            precision="bf16-mixed" if job["compute"] == "bfloat16" else "32-true",
            loss_type="l2",
            lane_weight=10,
            guidance_scale=4.0,
        ),
        eval=Config(seed=0, return_diffusion_chain=False),
    )
    return LDM(config, None)


def autoencoder_config(job):
    """Settings of the release's autoencoder."""
    return Config(
        job["sizes"],
        lane_attr=2,
        dropout=0,
        state_dim=9,
        num_agent_types=3,
        lane_conn_attr=4,
        num_lane_types=3,
        kl_weight=1e-2,
        lane_weight=10,
        lane_conn_weight=10,
        cond_dis_weight=0.1,
        num_points_per_lane=20,
        max_num_lanes=100,
    )


def make_batch(job, scenes):
    """Random scenes of the given numbers of lanes and agents, in the release's own batch type."""
    from torch_geometric.data import Batch

    return Batch.from_data_list([make_scene(job, lanes, agents) for lanes, agents in scenes])


def make_scene(job, lanes, agents):
    """One scene with complete graphs."""
    from utils.data_container import ScenarioDreamerData
    from utils.pyg_helpers import get_edge_index_bipartite, get_edge_index_complete_graph

    data = ScenarioDreamerData()
    data["lg_type"], data["map_id"] = torch.tensor([0]), torch.tensor([0])
    data["num_lanes"], data["num_agents"] = torch.tensor([lanes]), torch.tensor([agents])
    edges = {
        ("lane", "to", "lane"): get_edge_index_complete_graph(lanes),
        ("agent", "to", "agent"): get_edge_index_complete_graph(agents),
        ("lane", "to", "agent"): get_edge_index_bipartite(lanes, agents),
    }
    for name, edge_index in edges.items():
        data[name].edge_index = edge_index
        data[name].encoder_mask = torch.ones(edge_index.shape[1], dtype=torch.bool)
    for name, number in (("lane", lanes), ("agent", agents)):
        data[name].partition_mask = torch.zeros(number, dtype=torch.bool)
    if job["kind"] == "autoencoder":
        data["lane"].x, data["agent"].x = torch.randn(lanes, 20, 2), torch.randn(agents, 9)
        data["lane"].type, data["agent"].type = one_hot(lanes, 3), one_hot(agents, 3)
        data["lane", "to", "lane"].type = one_hot(lanes * lanes, 4)
        data["num_lanes_after_origin"] = torch.tensor([0])
        return data
    sizes = job["sizes"]
    data["lane"].latents = data["lane"].x = torch.randn(lanes, sizes["lane_latent_dim"])
    data["agent"].latents = data["agent"].x = torch.randn(agents, sizes["agent_latent_dim"])
    if job["kind"] == "text":
        data["text"], data["text_embeds"] = "a prompt", torch.randn(TEXT_TOKENS, TEXT_WIDTH)
    if job["kind"] == "image":
        data["dino_feats"], data["depth_map"] = torch.randn(1, 384, 14, 14), torch.rand(1, 1, 384, 672)
    return data


def one_hot(number, classes):
    """Random classes."""
    return torch.nn.functional.one_hot(torch.randint(0, classes, (number,)), classes).float()


def roofline(job):
    """GFLOP/s of a large matrix product in the timed precision."""
    dtype = {"float32": torch.float32, "bfloat16": torch.bfloat16}[job["compute"]]
    x, best = torch.ones(2048, 2048, dtype=dtype), float("inf")
    for _ in range(6):
        start = time.perf_counter()
        x @ x
        best = min(best, time.perf_counter() - start)
    return 2 * 2048**3 / best / 1e9


if __name__ == "__main__":
    main(sys.argv[1], json.loads(sys.argv[2]))
