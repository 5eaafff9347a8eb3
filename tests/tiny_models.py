"""Networks of a few weights: segmentation models, and features of styles."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import transformers
from safetensors.torch import save_file
from transformers.models.sam3 import configuration_sam3

from stylesplat.stylization.features import Convolution, FeatureNetwork

tf: Any = transformers  # its configurations are typed, what is common to them here is not
sam3: Any = configuration_sam3
SIDE = 64  # pixels of what the SAM models see; their masks have a quarter
SAM3_SIDE = 56  # a multiple of its patches of 14
HIDDEN = 128  # more than the 64 channels that memories have in every size
WORDS = "[PAD] [UNK] [CLS] [SEP] [MASK] . red green blue ball table".split()
TINY: dict[str, Any] = {"hidden_size": HIDDEN, "num_attention_heads": 2, "intermediate_size": 16}
MEMORY: dict[str, Any] = {
    "num_maskmem": 3,
    "max_object_pointers_in_encoder": 4,
    "memory_attention_hidden_size": HIDDEN,
    "memory_attention_num_layers": 1,
    "memory_encoder_hidden_size": HIDDEN,
    "mask_downsampler_embed_dim": HIDDEN,
    "memory_fuser_num_layers": 1,
    "memory_fuser_embed_dim": HIDDEN,
    "memory_fuser_intermediate_dim": 16,
}
MASK_DECODER: dict[str, Any] = {
    "hidden_size": HIDDEN,
    "mlp_dim": 16,
    "num_hidden_layers": 1,
    "num_attention_heads": 1,
    "iou_head_depth": 2,
    "iou_head_hidden_dim": 8,
}


def write_model(kind: str, folder: Path) -> Path:
    """Write a model with its processor as `save_pretrained` does, and return the folder."""
    tf.logging.set_verbosity_error()
    tf.logging.disable_progress_bar()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        BUILDERS[kind](folder)
    return folder


def _sam(folder: Path) -> None:
    vision = tf.SamVisionConfig(
        **{"hidden_size": 16, "num_attention_heads": 2, "mlp_dim": 16, "num_hidden_layers": 1},
        **{"output_channels": HIDDEN, "image_size": SIDE, "window_size": 2},
        **{"num_pos_feats": HIDDEN // 2},
        global_attn_indexes=[0],
    )
    prompts = tf.SamPromptEncoderConfig(hidden_size=HIDDEN, image_size=SIDE, mask_input_channels=4)
    decoder = tf.SamMaskDecoderConfig(**MASK_DECODER)
    config = tf.SamConfig(
        vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=decoder
    )
    _varied(tf.SamModel(config)).save_pretrained(folder)
    images = tf.SamImageProcessor(
        size={"longest_edge": SIDE},
        pad_size={"height": SIDE, "width": SIDE},
        mask_size={"longest_edge": SIDE // 4},
        mask_pad_size={"height": SIDE // 4, "width": SIDE // 4},
    )
    tf.SamProcessor(images).save_pretrained(folder)


def _sam2(folder: Path) -> None:
    backbone = tf.Sam2HieraDetConfig(
        **{"hidden_size": 8, "image_size": [SIDE, SIDE], "blocks_per_stage": [1, 1, 1, 1]},
        **{"embed_dim_per_stage": [8, 16, 24, 32], "num_attention_heads_per_stage": [1] * 4},
        **{"window_size_per_stage": [4] * 4, "global_attention_blocks": []},
        window_positional_embedding_background_size=[2, 2],
    )
    vision = tf.Sam2VisionConfig(backbone_config=backbone, **_pyramid([32, 24, 16, 8]))
    config = tf.Sam2VideoConfig(
        vision_config=vision,
        **_heads("Sam2Video"),
        **MEMORY,
        image_size=SIDE,
        memory_attention_feed_forward_hidden_size=16,
        memory_attention_rope_feat_sizes=[SIDE // 16, SIDE // 16],
    )
    _varied(tf.Sam2VideoModel(config)).save_pretrained(folder)
    _sam2_processor(folder)


def _edgetam(folder: Path) -> None:
    backbone = tf.TimmWrapperConfig(
        architecture="repvit_m1",
        model_args={
            **{"in_chans": 3, "features_only": True, "out_indices": [0, 1, 2, 3]},
            **{"embed_dim": [8] * 4, "depth": [1] * 4},
        },
    )
    vision = tf.EdgeTamVisionConfig(backbone_config=backbone, **_pyramid([8] * 4))
    config = tf.EdgeTamVideoConfig(
        vision_config=vision,
        **_heads("EdgeTamVideo"),
        **MEMORY,
        image_size=SIDE,
        memory_attention_mlp_hidden_size=16,
        memory_attention_rope_feat_sizes=[SIDE // 16, SIDE // 16],
        memory_attention_rope_k_sizes=[2, 2],
        perceiver_resampler_num_latents=4,
        perceiver_resampler_num_latents_2d=4,
        perceiver_resampler_mlp_intermediate_size=8,
        perceiver_resampler_num_layers=1,
    )
    _varied(tf.EdgeTamVideoModel(config)).save_pretrained(folder)
    _sam2_processor(folder)


def _sam3(folder: Path) -> None:
    """The layout of `facebook/sam3`: detector and tracker in one file.

    `save_pretrained` would write the tracker's prefix twice, which only some classes read.
    """
    detector = tf.Sam3Config(
        vision_config=_sam3_vision(),
        text_config={
            **{"model_type": "clip_text_model", "vocab_size": 10, "num_hidden_layers": 1, **TINY},
            **{"projection_dim": 16, "max_position_embeddings": 32},
        },
        geometry_encoder_config=sam3.Sam3GeometryEncoderConfig(num_layers=1, **TINY),
        detr_encoder_config=sam3.Sam3DETREncoderConfig(num_layers=1, **TINY),
        detr_decoder_config=sam3.Sam3DETRDecoderConfig(num_layers=1, num_queries=5, **TINY),
        mask_decoder_config=sam3.Sam3MaskDecoderConfig(hidden_size=HIDDEN, num_attention_heads=2),
    )
    tracker = tf.Sam3TrackerVideoConfig(
        vision_config=_sam3_vision(),
        **_heads("Sam3TrackerVideo", SAM3_SIDE, 14),
        **MEMORY,
        image_size=SAM3_SIDE,
        memory_attention_feed_forward_hidden_size=16,
    )
    config = tf.Sam3VideoConfig(
        detector_config=detector, tracker_config=tracker, low_res_mask_size=16
    )
    config.save_pretrained(folder)
    weights = _varied(tf.Sam3VideoModel(config)).state_dict()
    weights = {name: tensor.clone() for name, tensor in weights.items()}
    save_file(weights, folder / "model.safetensors", metadata={"format": "pt"})
    size = {"height": SAM3_SIDE, "width": SAM3_SIDE}
    parts = ["<|startoftext|>", "<|endoftext|>", "r", "e", "d", "r</w>", "e</w>", "d</w>"]
    parts += ["re", "red</w>"]
    vocab = {part: index for index, part in enumerate(parts)}
    tf.Sam3VideoProcessor(
        image_processor=tf.Sam3ImageProcessor(size=size),
        video_processor=tf.Sam2VideoVideoProcessor(size=size),
        tokenizer=tf.CLIPTokenizer(vocab=vocab, merges=[("r", "e"), ("re", "d</w>")]),
        target_size=SAM3_SIDE,
    ).save_pretrained(folder)


def _grounding_dino(folder: Path) -> None:
    config = tf.GroundingDinoConfig(
        backbone_config=tf.SwinConfig(
            **{"embed_dim": 8, "depths": [1] * 4, "num_heads": [1] * 4, "window_size": 2},
            out_indices=[2, 3, 4],
        ),
        text_config=tf.BertConfig(
            vocab_size=len(WORDS), num_hidden_layers=1, max_position_embeddings=16, **TINY
        ),
        **{"num_queries": 6, "d_model": 32, "max_text_len": 16},
        **{"encoder_layers": 1, "encoder_ffn_dim": 16, "encoder_attention_heads": 2},
        **{"decoder_layers": 2, "decoder_ffn_dim": 16, "decoder_attention_heads": 2},
    )
    tf.GroundingDinoForObjectDetection(config).save_pretrained(folder)
    words = folder / "vocab.txt"
    words.write_text("\n".join(WORDS))
    images = tf.GroundingDinoImageProcessor(size={"shortest_edge": 96, "longest_edge": 128})
    tf.GroundingDinoProcessor(images, tf.BertTokenizer(vocab=str(words))).save_pretrained(folder)


def _pyramid(channels: list[int]) -> dict[str, Any]:
    sizes = [[SIDE // step, SIDE // step] for step in (4, 8, 16)]
    return {
        **{"backbone_channel_list": channels, "backbone_feature_sizes": sizes},
        "fpn_hidden_size": HIDDEN,
    }


def _heads(family: str, side: int = SIDE, patch: int = 16) -> dict[str, Any]:
    prompts = getattr(tf, f"{family}PromptEncoderConfig")
    decoder = getattr(tf, f"{family}MaskDecoderConfig")
    return {
        "prompt_encoder_config": prompts(
            hidden_size=HIDDEN, image_size=side, patch_size=patch, mask_input_channels=4
        ),
        "mask_decoder_config": decoder(**MASK_DECODER),
    }


def _sam3_vision() -> Any:
    backbone = tf.Sam3ViTConfig(
        **TINY,
        **{"num_hidden_layers": 1, "image_size": SAM3_SIDE, "patch_size": 14, "window_size": 2},
        **{"global_attn_indexes": [0], "pretrain_image_size": 28},
    )
    sizes = [[16, 16], [8, 8], [4, 4]]
    return tf.Sam3VisionConfig(
        backbone_config=backbone, fpn_hidden_size=HIDDEN, backbone_feature_sizes=sizes
    )


def _sam2_processor(folder: Path) -> None:
    size = {"height": SIDE, "width": SIDE}
    images = tf.Sam2ImageProcessor(size=size, mask_size={"height": SIDE // 4, "width": SIDE // 4})
    videos = tf.Sam2VideoVideoProcessor(size=size)
    tf.Sam2VideoProcessor(images, videos, target_size=SIDE).save_pretrained(folder)


def _varied(model: Any) -> Any:
    """Weights as chance made them hardly react to the photo; larger ones do."""
    for parameter in model.parameters():
        if parameter.ndim > 1:
            torch.nn.init.kaiming_normal_(parameter)
    return model


BUILDERS: dict[str, Callable[[Path], None]] = {
    "sam": _sam,
    "sam2": _sam2,
    "edgetam": _edgetam,
    "sam3": _sam3,
    "grounding-dino": _grounding_dino,
}


@pytest.fixture(scope="session")
def network() -> FeatureNetwork:
    """Two blocks of few random filters; features of block 2 span 10 pixels."""
    generator = torch.Generator().manual_seed(0)
    blocks, inputs = [], 3
    for widths in ((8, 8), (12,)):
        convs = []
        for width in widths:
            weight = torch.randn(width, inputs, 3, 3, generator=generator) / (9 * inputs) ** 0.5
            convs.append(Convolution(weight, torch.zeros(width)))
            inputs = width
        blocks.append(tuple(convs))
    return FeatureNetwork(tuple(blocks), torch.full((3,), 0.5), torch.full((3,), 0.25))


@pytest.fixture(scope="session")
def stripes() -> torch.Tensor:
    """A style image of 48x40 pixels: slanted stripes of three colours."""
    ys, xs = torch.meshgrid(torch.arange(40), torch.arange(48), indexing="ij")
    colors = torch.tensor([[0.9, 0.8, 0.1], [0.1, 0.1, 0.6], [0.8, 0.2, 0.1]])
    return colors[(xs + 2 * ys) // 5 % 3]
