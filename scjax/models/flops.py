"""Closed-form useful work: floating-point operations on real tokens only, as scjax factors the products.

A multiply-add counts 2. Norms, activations and softmaxes are left out. Padding is not useful, so it does not count.
"""

from __future__ import annotations

from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.nn.cross_attention import NoOptions


def autoencoder_forward(config: AutoencoderConfig, lanes: int, agents: int) -> float:
    """Encoder and decoder of one scene."""
    wide, narrow, edge = config.lane_width, config.agent_width, config.edge_width
    pairs = lanes * lanes

    def attention(width: int, ff: int, targets: int, sources: int) -> float:
        tokens = targets * (5 * width**2 + 2 * width * ff) + sources * 2 * width**2
        return tokens + (0 if targets == sources else targets * width**2) + 2 * targets * sources * width

    def block(update: bool, dense: bool) -> float:
        lane_lane = attention(wide, config.lane_ff, lanes, lanes) + 2 * lanes * wide * edge
        lane_lane += 2 * pairs * config.lane_heads * edge
        agents_part = attention(narrow, config.agent_ff, agents, lanes)
        agents_part += attention(narrow, config.agent_ff, agents, agents)
        # Edges that come in as a table or as sums of node terms are projected before they are pairs.
        edges = 4 * lanes * narrow * edge + (6 if dense else 4) * pairs * edge**2 if update else 0
        return lane_lane + lanes * wide * narrow + agents_part + edges

    def mlp(inputs: int, width: int, depth: int, outputs: int = 0) -> float:
        return 2 * inputs * width + (depth - 1) * width**2 + width * outputs

    encoder = lanes * mlp(config.lane_inputs, wide, 2) + agents * mlp(config.agent_inputs, narrow, 2)
    encoder += sum(block(update=i < config.encoder_blocks - 1, dense=i > 0) for i in range(config.encoder_blocks))
    encoder += config.encoder_blocks * attention(wide, config.lane_ff, 1, lanes)
    encoder += 2 * (lanes * wide * config.lane_latent + agents * narrow * config.agent_latent)
    decoder = lanes * config.lane_latent * wide + agents * config.agent_latent * narrow
    decoder += lanes * (wide * edge + 2 * edge**2)
    decoder += sum(block(update=True, dense=i > 0) for i in range(config.decoder_blocks))
    decoder += agents * (mlp(narrow, narrow, 3, config.columns) + mlp(narrow, narrow, 2, config.agent_types))
    decoder += lanes * mlp(wide, wide, 3, config.points * config.point_dims)
    decoder += lanes * mlp(wide, wide, 2, config.lane_types) + pairs * mlp(edge, edge, 2, config.link_types)
    return 2.0 * (encoder + decoder)


def denoiser_forward(config: DenoiserConfig, lanes: int, agents: int, context: int = 0, cached: bool = False) -> float:
    """One evaluation of one scene; ``context`` condition tokens, whose keys and values may be ``cached``."""
    wide, narrow = config.lane_width, config.agent_width

    def cross(width: int, heads: int, targets: int) -> float:
        if not context or isinstance(config.cross_attention, NoOptions):
            return 0.0
        work = config.cross_attention.work(width, heads, config.context_spec, targets, context)
        return float(3 * width**2 + work.attend + (0 if cached else work.encode))

    def stage(width: int, heads: int, targets: int, sources: int) -> float:
        tokens = targets * (2 + 2 * config.mlp_ratio) * width**2 + sources * 2 * width**2
        rows = (6 + (6 if targets != sources else 0)) * width**2
        return tokens + rows + 2 * targets * sources * width + cross(width, heads, targets)

    lane, agent = (wide, config.lane_heads), (narrow, config.agent_heads)
    block = stage(*lane, lanes, agents) + config.l2l_stages * stage(*lane, lanes, lanes)
    block += stage(*agent, agents, lanes) + stage(*agent, agents, agents) + (lanes + agents) * wide * narrow
    embed = lanes * (2 * config.lane_latent * wide + wide**2) + agents * (2 * config.agent_latent * narrow + narrow**2)
    heads = 2 * (wide**2 + narrow**2) + lanes * wide * config.lane_latent + agents * narrow * config.agent_latent
    project = 0
    if isinstance(config.cross_attention, NoOptions):
        context = 0  # nobody reads it
    if context and not cached and isinstance(config.condition, TextCondition):
        project = context * (config.condition.width * (wide + narrow) + wide**2 + narrow**2)
    if context and not cached and isinstance(config.condition, ImageCondition):
        project = context // 2 * config.condition.channels * wide + context * wide * narrow
    return 2.0 * (config.blocks * block + embed + heads + 256 * wide + wide**2 + 2 * wide * narrow + project)
