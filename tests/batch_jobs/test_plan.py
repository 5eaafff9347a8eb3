"""From job files to jobs: products, names, commands, and what is refused before anything runs."""

from pathlib import Path

import pytest

from processes import VERBS, planned, write_jobs
from stylesplat.batch_jobs.job_file import plan_batch
from stylesplat.batch_jobs.job_process import process_command
from stylesplat.errors import StyleSplatError

CHAIN = """
    scenes: [garden, desk]
    jobs:
      - stylize: {style: {vase: [wave.jpg, night.jpg]}, scale: [1, 2.5], steps: 30}
        then:
          - export: {output: vase.ply}
"""


def words(folder: Path, text: str) -> list[tuple[str, ...]]:
    return [job.command(folder / "out") for job in planned(folder, text).values()]


def jobs(options: str) -> str:
    return f"scenes: [garden]\njobs:\n  - {options}\n"


def make_photos(folder: Path) -> None:
    (folder / "photos" / "images").mkdir(parents=True)
    (folder / "photos" / "transforms.json").write_text("{}")


def test_lists_multiply(tmp_path: Path):
    found = planned(tmp_path, CHAIN)
    assert len(found) == 2 * 2 * 2 * 2
    styled = [name for name, job in found.items() if job.verb.name == "stylize"]
    assert styled[:2] == ["garden-stylize-vase-wave-scale-1", "garden-stylize-vase-wave-scale-2.5"]
    export = found["desk-stylize-vase-night-scale-1-export"]
    assert export.after == "desk-stylize-vase-night-scale-1"
    scene, folder = (tmp_path / "out" / name for name in (export.after, export.name))
    made = ("--overwrite", "--json")
    assert export.command(tmp_path / "out") == (
        "export",
        f"{scene}",
        f"--output={folder / 'vase.ply'}",
        *made,
    )


def test_a_training_on_several_gpus_is_torchrun_s(tmp_path: Path):
    make_photos(tmp_path)
    text = (
        "scenes: [photos]\njobs:\n  - train: {}\n    needs: {gpus: 4}\n  - train: {}\n    name: t\n"
    )
    several, alone = (process_command(job, tmp_path) for job in planned(tmp_path, text).values())
    place = several.index("--nproc-per-node")
    assert several[place + 1 : place + 5] == ["4", "-m", "stylesplat", "train"]
    assert "torch.distributed.run" in several and "torch.distributed.run" not in alone


def test_a_command_is_that_of_the_command_line(tmp_path: Path):
    options = "style: {vase: wave.jpg, pot: [[wave.jpg, night.jpg]]}, region: [[0, 0, 9, 8]]"
    ((verb, scene, *rest),) = words(tmp_path, jobs(f"stylize: {{{options}}}"))
    wave, night = tmp_path / "wave.jpg", tmp_path / "night.jpg"
    assert (verb, scene) == ("stylize", str(tmp_path / "garden"))
    styles = [f"--style=vase={wave}", f"--style=pot={wave},{night}"]
    place = ["-o", str(tmp_path / "out" / "garden-stylize")]
    last = ["--region", "0", "0", "9", "8", *place, "--overwrite", "--json"]
    assert rest == [*styles, *last]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("select: {name: x, id: [1, [2, 3]]}", ["id-1", "id-2-3"]),
        (
            "select: {name: x, id: 1, keep_outliers: [true, false]}",
            ["keep-outliers", "no-keep-outliers"],
        ),
        ("stylize: {style: {a: wave.jpg}, seed: [null, 3]}", ["seed-default", "seed-3"]),
        ("stylize: {style: [{a: wave.jpg}, {b: wave.jpg}]}", ["a-wave", "b-wave"]),
        ("stylize: {style: {a: [wave.jpg, wave.png]}}", ["a-wave.jpg", "a-wave.png"]),
        (
            "stylize: {style: {a: [wave.jpg, other/wave.jpg]}}",
            ["a-{here}-wave.jpg", "a-other-wave.jpg"],
        ),
        ("stylize: {style: {a: [wave.jpg, night.jpg], b: wave.png}}", ["a-wave", "a-night"]),
        ("export: {output: [a.ply, a.spz]}", ["a.ply", "a.spz"]),
        ("select: {name: x, point: ['v.jpg:1,2', ['v.jpg:3,4', 'w.jpg:5,6']]}", None),
    ],
)
def test_names_say_what_varies(options: str, expected: list[str] | None, tmp_path: Path):
    found = list(planned(tmp_path, jobs(options)))
    if expected is None:
        assert found[0].endswith("point-v.jpg-1-2") and len(found) == 2
        return
    verb = options.partition(":")[0]
    assert found == [f"garden-{verb}-{e.format(here=tmp_path.name)}" for e in expected]


def test_long_names_are_cut_and_still_differ(tmp_path: Path):
    options = f"select: {{name: [{'x' * 200}a, {'x' * 200}b], id: 1}}"
    one, other, deep = planned(tmp_path, jobs(options) + "  - render: {}\n    name: deep\n")
    assert len(one) < 100 and one != other and deep == "garden-deep"


def test_a_sheet_has_a_style_and_two_things_that_vary(tmp_path: Path):
    text = jobs(
        "sheet: {output: a.png, style: {vase: [wave.jpg, night.jpg]}, "
        'vary: [["scale=1,2", "color=style,keep"]]}'
    )
    planned_jobs = planned(tmp_path, text)
    assert [*planned_jobs] == ["garden-sheet-vase-wave", "garden-sheet-vase-night"]
    place = tmp_path / "garden-sheet-vase-wave"
    found = planned_jobs[place.name].command(tmp_path)
    assert found[:2] == ("sheet", str(tmp_path / "garden")) and f"--output={place}/a.png" in found
    assert {"--vary=scale=1,2", "--vary=color=style,keep"} <= {*found} and "-o" not in found


def test_masking_a_capture_works_on_a_copy(tmp_path: Path):
    make_photos(tmp_path)
    text = """
        scenes: [photos]
        jobs:
          - mask: {box: "vase=a.jpg:1,2,3,4"}
            then:
              - train: {steps: 10}
    """
    mask, train = planned(tmp_path, text).values()
    copy = tmp_path / "photos-mask"
    assert mask.edits_copy and mask.source_in(tmp_path) == tmp_path / "photos"
    words = mask.command(tmp_path)
    assert words[:2] == ("mask", str(copy)) and "-o" not in words
    assert train.command(tmp_path)[:2] == ("train", str(copy))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("scenes: [garden]\njob: []\n", "line 2: there is no key 'job'. Did you mean 'jobs'?"),
        (jobs("stylise2: {}"), "line 3: there is no key 'stylise2'. Did you mean 'stylize'?"),
        (
            "scenes: [garden]\njobs:\n  - stylize:\n      style: {a: wave.jpg}\n      scal: 1\n",
            "line 5: Unrecognized options: --scal=1. Did you mean --scale?",
        ),
        (jobs("render: {json: true}"), "json is set by the batch itself"),
        (jobs("stylize: {output: x}"), "output is set by the batch itself"),
        (jobs("render: {}\n    export: {}"), "line 3: a job has one verb, got render and export"),
        (jobs("name: x"), "a job has one verb, got none"),
        ("scenes: [gardn]\njobs:\n  - render: {}\n", "There is no scene"),
        ("jobs:\n  - render: {}\n", "line 2: render has no scenes"),
        ("scenes: [garden, ./garden]\njobs: [{render: {}}]\n", "have one name, garden"),
        ("scenes: [wave.jpg]\njobs: [{render: {}}]\n", "wave.jpg"),
        (jobs("train: {}"), "line 3: train works on captures, not on garden"),
        (jobs("stylize: {style: {a: wav.jpg}}"), "line 3: style: there is no "),
        (
            "scenes:\n  - s3://a/garden\njobs: [{render: {}}]\n",
            "line 2: 's3://a/garden' is an address",
        ),
        (jobs("stylize: {style: {a: gs://b/wave.jpg}}"), "line 3: 'gs://b/wave.jpg' is an address"),
        (jobs("stylize: {recipe: no.yaml}"), "line 3: recipe: there is no "),
        (jobs("stylize: {style: a=wave.jpg}"), "line 3: style is a map"),
        (jobs("stylize: {style: {a: []}}"), "line 3: style lists no pictures for a"),
        (jobs("stylize: {scale: fast}"), "line 3: Error parsing --scale/--stroke-size"),
        (jobs("stylize: {scale: [[1, 2]]}"), "line 3: scale takes one value"),
        (jobs("stylize: {region: [0, 0, 9, 9]}"), "line 3: "),
        (jobs("stylize: {scale: []}"), "scale lists nothing"),
        (jobs("select: {keep-outliers: 3}"), "keep-outliers is true or false, not 3"),
        (jobs("select: {id: 1}"), "--name"),
        (jobs("export: {}"), "line 3: export makes a file in the job's folder. Name it with"),
        (jobs("export: {output: ../x.ply}"), "output is a name in the job's own folder"),
        (jobs("render: {}\n    then: [{render: {}}]"), "line 4: nothing can follow render"),
        (jobs("render: {}\n    needs: {cpu: 1}"), "line 4: there is no key 'cpu'. Did you mean"),
        (jobs("render: {}\n    needs: {cpus: 0}"), "line 4: expected `int` >= 1"),
        (jobs("render: {}") + "  - render: {what: depth}\n", "line 3, 4"),
        (jobs("render: {downscale: [2, 2]}"), "remove what is listed twice"),
        (jobs("stylize: {stroke_size: 1, stroke-size: 2}"), "stroke-size is listed twice"),
        (
            jobs(f"stylize: {{seed: {[*range(200)]}, steps: {[*range(1, 200)]}}}"),
            "multiply to 39,800 jobs",
        ),
        ("scenes: [garden]\njobs: []\n", "line 2: expected `array` of length >= 1"),
        (jobs("render: [x]"), "line 3: expected `object | null`, got `array`"),
        ("- render\n", "line 1: expected `object`, got `array`"),
        ("scenes: [garden\n", "is no valid YAML"),
    ],
)
def test_what_is_wrong_is_told_before_anything_runs(text: str, fault: str, tmp_path: Path):
    with pytest.raises(StyleSplatError) as raised:
        plan_batch(write_jobs(tmp_path, text), VERBS)
    assert fault in str(raised.value) and str(tmp_path / "jobs.yaml") in str(raised.value)


def test_what_jobs_know_of_verbs():
    assert "from" in VERBS["mask"].paths and "output" not in VERBS["render"].paths
    assert VERBS["select"].flags >= {"no-picture", "keep-outliers"}
    assert "point" in VERBS["select"].several and "name" not in VERBS["select"].several
