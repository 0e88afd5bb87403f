"""Networks of the classes that see, with weights drawn at random: tiny ones, and some of the shape of those that are published."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

Shape = Literal["tiny", "published"]

WORDS = ("mug", "book", "red", "pen", "a", "photo", "of", "coffee", "table", ".")
"""That the tokenizer of BERT knows."""

LETTERS = 200
"""Tokens that the one of CLIP knows: letters, alone and at the end of a word."""

CLASSES = ("person", "cup", "book", "chair", "mouse")
"""Of a detector whose set is closed."""

SEED = 3

SPREAD = 0.3
"""Deviation of the weights of tiny ones: as they are drawn before a training, they hardly tell one picture from another."""

SIDES = {"tiny": 64, "published": 432}
"""Pixels of the square that RF-DETR takes; published for its medium size."""


def drawn_network(name: str, shape: Shape) -> Any:
    """A network, the same for the same name and shape."""
    import torch

    torch.manual_seed(SEED)
    network = NETWORKS[name](shape).eval()
    with torch.no_grad():  # embeddings and heads that begin as zeros say nothing
        for part, parameter in network.named_parameters():
            if not parameter.any() and part != "segmentation_bias":
                parameter.copy_(0.2 * torch.randn(parameter.shape))
    return network


def weights_bytes(name: str) -> int:
    """What the weights of a network of published shape take in single precision; none is made for that."""
    import torch

    with torch.device("meta"):
        network = NETWORKS[name]("published")
    return 4 * sum(parameter.numel() for parameter in network.parameters())


def write_networks(folder: Path) -> None:
    """A folder with a tiny one of each, as transformers writes them, in a folder."""
    for name in NETWORKS:
        drawn_network(name, "tiny").save_pretrained(folder / name)
    word_tokenizer(folder).save_pretrained(folder / "grounding_dino")
    letter_tokenizer(folder).save_pretrained(folder / "owlv2")


def word_tokenizer(folder: Path) -> Any:
    """A tokenizer of BERT that knows a few words. folder: Where its files may lie."""
    from transformers import BertTokenizer

    (folder / "vocab.txt").write_text("\n".join(["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", *WORDS]) + "\n")
    return BertTokenizer(vocab=str(folder / "vocab.txt"))


def letter_tokenizer(folder: Path) -> Any:
    """A tokenizer of CLIP that knows letters. folder: Where its files may lie."""
    from transformers import CLIPTokenizer

    letters = [chr(code) for code in range(33, 127)]
    tokens = [*letters, *(f"{letter}</w>" for letter in letters)]
    tokens += [f"<unused{i}>" for i in range(LETTERS - 2 - len(tokens))] + ["<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({token: index for index, token in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    return CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=40)


def _transformers() -> Any:
    """Its classes, whose configs take more than their signatures say."""
    import transformers

    return transformers


def _sam2(shape: Shape) -> Any:
    """SAM 2: as hiera-tiny, or four stages of one or two blocks."""
    kinds = _transformers()
    if shape == "published":
        return kinds.Sam2Model(kinds.Sam2Config())
    backbone = kinds.Sam2HieraDetConfig(
        hidden_size=8, num_attention_heads=1, image_size=[128, 128], blocks_per_stage=[1, 1, 2, 1], embed_dim_per_stage=[8, 16, 32, 64],
        num_attention_heads_per_stage=[1, 1, 2, 2], window_size_per_stage=[8, 4, 4, 4], global_attention_blocks=[3],
        initializer_range=SPREAD,
    )  # fmt: skip
    vision = kinds.Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], backbone_feature_sizes=[[32, 32], [16, 16], [8, 8]],
        fpn_hidden_size=32, initializer_range=SPREAD,
    )  # fmt: skip
    prompts = kinds.Sam2PromptEncoderConfig(hidden_size=32, image_size=128, patch_size=16)
    decoder = kinds.Sam2MaskDecoderConfig(hidden_size=32, mlp_dim=32, num_hidden_layers=2, num_attention_heads=2, iou_head_hidden_dim=16)
    return kinds.Sam2Model(
        kinds.Sam2Config(vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=decoder, initializer_range=SPREAD)
    )


def _sam(shape: Shape) -> Any:
    """SAM: as vit-base, or two layers."""
    kinds = _transformers()
    if shape == "published":
        return kinds.SamModel(kinds.SamConfig())
    vision = kinds.SamVisionConfig(
        hidden_size=16, output_channels=32, num_hidden_layers=2, num_attention_heads=2, image_size=128, patch_size=16, window_size=4,
        global_attn_indexes=[1], mlp_dim=32, num_pos_feats=16, initializer_range=SPREAD,
    )  # fmt: skip
    prompts = kinds.SamPromptEncoderConfig(hidden_size=32, image_size=128, patch_size=16)
    decoder = kinds.SamMaskDecoderConfig(hidden_size=32, mlp_dim=32, num_hidden_layers=2, num_attention_heads=2, iou_head_hidden_dim=16)
    return kinds.SamModel(
        kinds.SamConfig(vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=decoder, initializer_range=SPREAD)
    )


def _grounding_dino(shape: Shape) -> Any:
    """Grounding DINO: as tiny, or a Swin of four layers and a BERT of two, two layers of each kind and ten queries."""
    kinds = _transformers()
    if shape == "published":
        backbone = kinds.SwinConfig(window_size=7, image_size=224, out_indices=[2, 3, 4])
        return kinds.GroundingDinoForObjectDetection(kinds.GroundingDinoConfig(backbone_config=backbone, disable_custom_kernels=True))
    backbone = kinds.SwinConfig(
        embed_dim=8, depths=[1, 1, 1, 1], num_heads=[1, 1, 2, 2], window_size=4, image_size=64, out_indices=[2, 3, 4],
        initializer_range=SPREAD,
    )  # fmt: skip
    text = kinds.BertConfig(
        vocab_size=20, hidden_size=16, num_hidden_layers=2, num_attention_heads=2, intermediate_size=32, max_position_embeddings=64
    )
    config = kinds.GroundingDinoConfig(
        backbone_config=backbone, text_config=text, num_queries=10, encoder_layers=2, decoder_layers=2, encoder_attention_heads=2,
        decoder_attention_heads=2, encoder_ffn_dim=32, decoder_ffn_dim=32, d_model=32, max_text_len=64, init_std=SPREAD,
        disable_custom_kernels=True,
    )  # fmt: skip
    return kinds.GroundingDinoForObjectDetection(config)


def _owlv2(shape: Shape) -> Any:
    """OWLv2: as base-patch16-ensemble, or two layers for pictures and two for texts."""
    kinds = _transformers()
    if shape == "published":
        return kinds.Owlv2ForObjectDetection(kinds.Owlv2Config(vision_config=kinds.Owlv2VisionConfig(image_size=960, patch_size=16)))
    small = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    first, last = LETTERS - 2, LETTERS - 1
    text = kinds.Owlv2TextConfig(
        **small, vocab_size=LETTERS, max_position_embeddings=40, bos_token_id=first, eos_token_id=last, pad_token_id=last
    )  # fmt: skip
    vision = kinds.Owlv2VisionConfig(**small, image_size=64, patch_size=16)
    return kinds.Owlv2ForObjectDetection(kinds.Owlv2Config(text_config=text, vision_config=vision, projection_dim=16))


def _rf_detr(shape: Shape) -> Any:
    """RF-DETR with masks: about as seg-medium, or a DINOv2 of four layers, two decoder layers and twelve queries."""
    kinds = _transformers()
    classes = dict(enumerate(CLASSES))
    if shape == "published":
        backbone = kinds.RfDetrDinov2Config(
            hidden_size=384, num_attention_heads=6, image_size=SIDES[shape], patch_size=12, num_windows=2,
            out_features=["stage3", "stage6", "stage9", "stage12"],
        )  # fmt: skip
        return kinds.RfDetrForInstanceSegmentation(
            kinds.RfDetrConfig(backbone_config=backbone, decoder_layers=5, num_queries=200, num_labels=91)
        )
    backbone = kinds.RfDetrDinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, image_size=SIDES[shape], patch_size=8, num_windows=2,
        out_features=["stage2", "stage4"], initializer_range=SPREAD,
    )  # fmt: skip
    config = kinds.RfDetrConfig(
        backbone_config=backbone, d_model=32, decoder_layers=2, decoder_self_attention_heads=2, decoder_cross_attention_heads=2,
        decoder_ffn_dim=32, num_queries=12, group_detr=1, c2f_num_blocks=1, id2label=classes, init_std=SPREAD,
    )  # fmt: skip
    return kinds.RfDetrForInstanceSegmentation(config)


NETWORKS: dict[str, Callable[[Shape], Any]] = {
    "sam2": _sam2, "sam": _sam, "grounding_dino": _grounding_dino, "owlv2": _owlv2, "rf_detr": _rf_detr,
}  # fmt: skip
"""Who makes a network, by the name of its provider."""
