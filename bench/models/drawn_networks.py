"""Networks of the classes that are used, with some thousands of weights drawn at random, in folders as transformers writes them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

WORDS = ("mug", "book", "red", "pen", "a", "photo", "of", "coffee", "table", ".")


def sam2(side: int = 128) -> Any:
    """SAM 2: four stages of one or two blocks."""
    from transformers import Sam2Config, Sam2HieraDetConfig, Sam2MaskDecoderConfig, Sam2Model, Sam2PromptEncoderConfig, Sam2VisionConfig

    backbone = Sam2HieraDetConfig(
        hidden_size=8, num_attention_heads=1, image_size=[side, side], blocks_per_stage=[1, 1, 2, 1], embed_dim_per_stage=[8, 16, 32, 64],
        num_attention_heads_per_stage=[1, 1, 2, 2], window_size_per_stage=[8, 4, 4, 4], global_attention_blocks=[3], initializer_range=0.3,
    )  # fmt: skip
    sizes = [[side // step, side // step] for step in (4, 8, 16)]
    vision = Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], backbone_feature_sizes=sizes, fpn_hidden_size=32,
        initializer_range=0.3,
    )  # fmt: skip
    prompts = Sam2PromptEncoderConfig(hidden_size=32, image_size=side, patch_size=16)
    decoder = Sam2MaskDecoderConfig(hidden_size=32, mlp_dim=32, num_hidden_layers=2, num_attention_heads=2, iou_head_hidden_dim=16)
    return Sam2Model(Sam2Config(vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=decoder, initializer_range=0.3))


def sam(side: int = 128) -> Any:
    """SAM: two layers."""
    from transformers import SamConfig, SamMaskDecoderConfig, SamModel, SamPromptEncoderConfig, SamVisionConfig

    vision = SamVisionConfig(
        hidden_size=16, output_channels=32, num_hidden_layers=2, num_attention_heads=2, image_size=side, patch_size=16, window_size=4,
        global_attn_indexes=[1], mlp_dim=32, num_pos_feats=16, initializer_range=0.3,
    )  # fmt: skip
    prompts = SamPromptEncoderConfig(hidden_size=32, image_size=side, patch_size=16)
    decoder = SamMaskDecoderConfig(hidden_size=32, mlp_dim=32, num_hidden_layers=2, num_attention_heads=2, iou_head_hidden_dim=16)
    return SamModel(SamConfig(vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=decoder, initializer_range=0.3))


def grounding_dino() -> Any:
    """Grounding DINO: a Swin and a BERT of two layers, two layers of each kind, ten queries."""
    from transformers import BertConfig, GroundingDinoConfig, GroundingDinoForObjectDetection, SwinConfig

    backbone = SwinConfig(
        embed_dim=8, depths=[1, 1, 1, 1], num_heads=[1, 1, 2, 2], window_size=4, image_size=64, out_indices=[2, 3, 4],
        initializer_range=0.3,
    )  # fmt: skip
    text = BertConfig(
        vocab_size=20, hidden_size=16, num_hidden_layers=2, num_attention_heads=2, intermediate_size=32, max_position_embeddings=64
    )
    return GroundingDinoForObjectDetection(
        GroundingDinoConfig(
            backbone_config=backbone,
            text_config=text,
            num_queries=10,
            encoder_layers=2,
            decoder_layers=2,
            encoder_attention_heads=2,
            decoder_attention_heads=2,
            encoder_ffn_dim=32,
            decoder_ffn_dim=32,
            d_model=32,
            max_text_len=64,
            init_std=0.3,
            disable_custom_kernels=True,
        )
    )


def owlv2() -> Any:
    """OWLv2: two layers for pictures, two for texts."""
    from transformers import Owlv2Config, Owlv2ForObjectDetection, Owlv2TextConfig, Owlv2VisionConfig

    small = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    text = Owlv2TextConfig(**small, vocab_size=200, max_position_embeddings=40, bos_token_id=198, eos_token_id=199, pad_token_id=199)
    vision = Owlv2VisionConfig(**small, image_size=64, patch_size=16)
    return Owlv2ForObjectDetection(Owlv2Config(text_config=text, vision_config=vision, projection_dim=16))


def rf_detr(classes: tuple[str, ...] = ("person", "cup", "book", "chair", "mouse")) -> Any:
    """RF-DETR with masks: a DINOv2 of four layers in four windows, two decoder layers, twelve queries."""
    from transformers import RfDetrConfig, RfDetrDinov2Config, RfDetrForInstanceSegmentation

    backbone = RfDetrDinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, image_size=64, patch_size=8, num_windows=2,
        out_features=["stage2", "stage4"], initializer_range=0.3,
    )  # fmt: skip
    return RfDetrForInstanceSegmentation(
        RfDetrConfig(
            backbone_config=backbone,
            d_model=32,
            decoder_layers=2,
            decoder_self_attention_heads=2,
            decoder_cross_attention_heads=2,
            decoder_ffn_dim=32,
            num_queries=12,
            group_detr=1,
            c2f_num_blocks=1,
            id2label=dict(enumerate(classes)),
            init_std=0.3,
        )
    )


NETWORKS: dict[str, Callable[[], Any]] = {
    "sam2": sam2, "sam": sam, "grounding_dino": grounding_dino, "owlv2": owlv2, "rf_detr": rf_detr
}  # fmt: skip


def write_networks(folder: Path) -> None:
    """A folder of each in a folder."""
    import torch

    for name, make in NETWORKS.items():
        torch.manual_seed(3)
        network = make().eval()
        with torch.no_grad():  # embeddings and heads that begin as zeros say nothing
            for part, parameter in network.named_parameters():
                if not parameter.any() and part != "segmentation_bias":
                    parameter.copy_(0.2 * torch.randn(parameter.shape))
        network.save_pretrained(folder / name)
    _write_words(folder / "grounding_dino")
    _write_letters(folder / "owlv2")


def _write_words(folder: Path) -> None:
    """A tokenizer of BERT that knows a few words."""
    from transformers import BertTokenizer

    known = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", *WORDS]
    (folder / "vocab.txt").write_text("\n".join(known) + "\n")
    BertTokenizer(vocab=str(folder / "vocab.txt")).save_pretrained(folder)


def _write_letters(folder: Path) -> None:
    """A tokenizer of CLIP that knows letters."""
    from transformers import CLIPTokenizer

    letters = [chr(code) for code in range(33, 127)]
    tokens = [*letters, *(f"{letter}</w>" for letter in letters)]
    tokens += [f"<unused{i}>" for i in range(198 - len(tokens))] + ["<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({token: index for index, token in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=40).save_pretrained(folder)
