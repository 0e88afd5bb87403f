"""Pipelines of Shap-E with some thousands of weights, drawn at random."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.tasks.candidates.generation.cubes import triangles


def write_pipelines(folder: Path) -> None:
    """Both, in folders `text` and `image`; the field is pushed up, so that it has a surface."""
    import torch
    from diffusers import HeunDiscreteScheduler, PriorTransformer, ShapEImg2ImgPipeline, ShapEPipeline
    from diffusers.pipelines.shap_e.renderer import ShapERenderer
    from transformers import (
        CLIPImageProcessor,
        CLIPTextConfig,
        CLIPTextModelWithProjection,
        CLIPTokenizer,
        CLIPVisionConfig,
        CLIPVisionModel,
    )

    letters = [chr(code) for code in range(33, 127)]
    words = {token: index for index, token in enumerate([*letters, *(f"{c}</w>" for c in letters), "<|startoftext|>", "<|endoftext|>"])}
    (folder / "vocab.json").write_text(json.dumps(words))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=77)
    torch.manual_seed(0)
    last = len(words) - 1
    small = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    text = CLIPTextModelWithProjection(
        CLIPTextConfig(
            **small, projection_dim=16, vocab_size=len(words), max_position_embeddings=77, bos_token_id=last - 1, eos_token_id=last
        )
    )
    eyes = CLIPVisionModel(CLIPVisionConfig(**small, image_size=32, patch_size=8))
    common: dict[str, Any] = {
        "num_attention_heads": 2, "attention_head_dim": 16, "embedding_dim": 16, "num_embeddings": 32, "embedding_proj_dim": 16,
        "time_embed_dim": 64, "num_layers": 1, "additional_embeddings": 0, "time_embed_act_fn": "gelu", "added_emb_type": None,
    }  # fmt: skip
    scheduler = HeunDiscreteScheduler(
        beta_schedule="exp", num_train_timesteps=1024, prediction_type="sample", use_karras_sigmas=True, clip_sample=True,
        clip_sample_range=1.0,
    )  # fmt: skip
    for name in ("text", "image"):
        renderer = ShapERenderer(
            param_shapes=((8, 93), (8, 8), (8, 8), (8, 8)), d_latent=16, d_hidden=8, n_output=12, background=(0.1, 0.1, 0.1)
        )
        with torch.no_grad():
            renderer.mlp.mlp[-1].weight[0] *= 0.02
            renderer.mlp.mlp[-1].bias[0] = 0.4
        for buffer, values in zip(("cases", "masks"), triangles(), strict=True):
            getattr(renderer.mesh_decoder, buffer).copy_(torch.from_numpy(values))
        if name == "text":
            prior = PriorTransformer(**common, clip_embed_dim=32, norm_in_type="layer", encoder_hid_proj_type=None)
            whole = ShapEPipeline(prior=prior, text_encoder=text, tokenizer=tokenizer, shap_e_renderer=renderer, scheduler=scheduler)
        else:
            prior = PriorTransformer(**common, clip_embed_dim=32, embedding_proj_norm_type="layer", encoder_hid_proj_type=None)
            processor = CLIPImageProcessor(size={"shortest_edge": 32}, crop_size={"height": 32, "width": 32})
            whole = ShapEImg2ImgPipeline(
                prior=prior, image_encoder=eyes, image_processor=processor, shap_e_renderer=renderer, scheduler=scheduler
            )
        whole.save_pretrained(folder / name)
