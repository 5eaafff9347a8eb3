"""From job files to jobs and their order, and what is refused before anything runs."""

import os
import re
from contextlib import nullcontext
from pathlib import Path

import pytest

from processes import VERBS, planned, pretend, write_jobs
from stylesplat.batch_jobs.job_file import plan_batch
from stylesplat.batch_jobs.job_process import process_command
from stylesplat.batch_jobs.run_batch import RECORDS, fingerprints, read_records, run_in_order
from stylesplat.errors import StyleSplatError

DOCS = (Path(__file__).parents[2] / "docs" / "batch.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", DOCS, re.DOTALL)

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


def test_both_spellings(tmp_path: Path):
    found = planned(tmp_path, CHAIN.replace("stylize", "stylise"))
    assert found.keys() == planned(tmp_path, CHAIN).keys()
    with pytest.raises(StyleSplatError, match="one verb, got stylize and stylise"):
        planned(tmp_path, jobs("{stylize: {style: {a: wave.jpg}}, stylise: {}}"))


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
        (
            "recolor: {object: '3', hue: 90, match: [material:jade, wave.jpg]}",
            ["match-material-jade", "match-wave.jpg"],
        ),
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
        (jobs("stylise2: {}"), "line 3: there is no key 'stylise2'. Did you mean 'stylise'?"),
        (
            "scenes: [garden]\njobs:\n  - stylize:\n      style: {a: wave.jpg}\n      scal: 1\n",
            "line 5: Unrecognized options: --scal=1. Did you mean --scale?",
        ),
        (jobs("render: {json: true}"), "json is set by the batch itself"),
        (jobs("render: {}\n    export: {}"), "line 3: a job has one verb, got render and export"),
        ("scenes: [gardn]\njobs:\n  - render: {}\n", "There is no scene"),
        ("jobs:\n  - render: {}\n", "line 2: render has no scenes"),
        ("scenes: [garden, ./garden]\njobs: [{render: {}}]\n", "have one name, garden"),
        (jobs("train: {}"), "line 3: train works on captures, not on garden"),
        (jobs("stylize: {style: {a: wav.jpg}}"), "line 3: style: there is no "),
        (
            "scenes:\n  - s3://a/garden\njobs: [{render: {}}]\n",
            "line 2: 's3://a/garden' is an address",
        ),
        (jobs("stylize: {style: a=wave.jpg}"), "line 3: style is a map"),
        (jobs("stylize: {style: {a: []}}"), "line 3: style lists no pictures for a"),
        (jobs("stylize: {scale: fast}"), "line 3: Error parsing --scale/--stroke-size"),
        (jobs("stylize: {scale: [[1, 2]]}"), "line 3: scale takes one value"),
        (jobs("stylize: {region: [0, 0, 9, 9]}"), "line 3: "),
        (jobs("select: {keep-outliers: 3}"), "keep-outliers is true or false, not 3"),
        (jobs("select: {id: 1}"), "--name"),
        (jobs("export: {}"), "line 3: export makes a file in the job's folder. Name it with"),
        (jobs("export: {output: ../x.ply}"), "output is a name in the job's own folder"),
        (jobs("render: {}\n    then: [{render: {}}]"), "line 4: nothing can follow render"),
        (jobs("render: {}\n    needs: {cpu: 1}"), "line 4: there is no key 'cpu'. Did you mean"),
        (jobs("render: {}\n    needs: {cpus: 0}"), "line 4: cpus cannot be 0: Expected `int` >= 1"),
        (jobs("render: {}") + "  - render: {what: depth}\n", "line 3, 4"),
        (jobs("render: {downscale: [2, 2]}"), "remove what is listed twice"),
        (jobs("stylize: {stroke_size: 1, stroke-size: 2}"), "stroke-size is listed twice"),
        (
            jobs(f"stylize: {{seed: {[*range(200)]}, steps: {[*range(1, 200)]}}}"),
            "multiply to 39,800 jobs",
        ),
        ("scenes: [garden]\njobs: []\n", "line 2: jobs cannot be []: Expected"),
        ("- render\n", "line 1: expected KEY: VALUE"),
        ("scenes: [garden\n", "is no valid YAML"),
    ],
)
def test_what_is_wrong_is_told_before_anything_runs(text: str, fault: str, tmp_path: Path):
    with pytest.raises(StyleSplatError) as raised:
        plan_batch(write_jobs(tmp_path, text), VERBS)
    assert fault in str(raised.value) and str(tmp_path / "jobs.yaml") in str(raised.value)


@pytest.mark.parametrize(("number", "count"), [(0, 24), (1, 2 * (1 + 1 + 6))])
def test_an_example_is_planned(number: int, count: int, tmp_path: Path):
    for folder in ("garden", "desk"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "scene.json").write_text("{}")
        (tmp_path / "photos" / folder).mkdir(parents=True)
        (tmp_path / "photos" / folder / "transforms.json").write_text("{}")
    for name in ("wave.jpg", "starry.jpg", "night.jpg", "desk.ply"):
        (tmp_path / name).touch()
    path = tmp_path / "jobs.yaml"
    path.write_text(EXAMPLES[number])
    jobs = plan_batch(path, VERBS)
    assert len(jobs) == count and len(EXAMPLES) == 2 and all(verb in DOCS for verb in VERBS)
    if number == 0:
        told = re.findall(r"^results/(garden\S+?)/", DOCS, re.MULTILINE)
        assert told and {*told} <= {job.name for job in jobs}


CHAIN_OF_TWO = """
    scenes: [garden, desk]
    jobs:
      - stylize: {style: {vase: wave.jpg}, scale: 2}
        then:
          - export: {output: vase.ply}
"""


@pytest.mark.parametrize("what", ["nothing", "picture", "scene", "drawn", "setting", "object"])
def test_a_fingerprint_is_of_inputs_and_settings(what: str, tmp_path: Path):
    jobs = planned(tmp_path, CHAIN_OF_TWO)
    before = fingerprints([*jobs.values()])
    if what == "picture":
        (tmp_path / "wave.jpg").write_text("another")
    elif what == "scene":
        os.utime(tmp_path / "garden" / "splats.ply", (1, 1))
    elif what == "drawn":
        (tmp_path / "garden" / "objects.png").write_text("drawn later")
    elif what == "setting":
        jobs = planned(tmp_path, CHAIN_OF_TWO.replace("2}", "3}"))
    elif what == "object":
        jobs = planned(tmp_path, CHAIN_OF_TWO.replace("vase: w", "pot: w"))
    after = fingerprints([*jobs.values()])
    changed = {name for name in before if before[name] != after[name]}
    expected = {"nothing": [], "drawn": [], "scene": [n for n in jobs if n.startswith("garden")]}
    assert changed == {*expected.get(what, jobs)}


def test_a_torn_line_costs_its_job_only(tmp_path: Path):
    path = tmp_path / RECORDS
    line = '{"job": "%s", "verb": "render", "status": "%s"}\n'
    path.write_text(line % ("a", "done") + line % ("b", "done") + line % ("b", "failed"))
    with path.open("a") as file:
        file.write('{"job": "c", "sta')
    assert {n: r.status for n, r in read_records(path).items()} == {"a": "done", "b": "failed"}
    assert read_records(tmp_path / "nowhere") == {}


def run(folder: Path, slots: int, failing: str = "", done: str = "") -> tuple[list[str], dict]:
    jobs, begun = planned(folder, CHAIN_OF_TWO), list[str]()
    runner = nullcontext(pretend(begun, lambda name: name == failing))
    records = run_in_order([j for n, j in jobs.items() if n != done], {done}, runner, slots)
    return begun, {record.job: record.status for record in records}


def test_jobs_follow_the_ones_they_need(tmp_path: Path):
    begun, statuses = run(tmp_path, 1)
    assert {*statuses.values()} == {"done"}
    assert begun == [*planned(tmp_path, CHAIN_OF_TWO)], (
        "a scene is finished before the next one begins"
    )
    begun, _ = run(tmp_path, 2)
    assert {*begun[:2]} == {"garden-stylize", "desk-stylize"}, "two run, each as soon as it can"
    begun, _ = run(tmp_path, 1, done="garden-stylize")
    assert begun[0] == "garden-stylize-export"


def test_a_failure_costs_what_follows_it_only(tmp_path: Path):
    _, statuses = run(tmp_path, 2, failing="garden-stylize")
    assert statuses == {
        "garden-stylize": "failed",
        "garden-stylize-export": "skipped",
        "desk-stylize": "done",
        "desk-stylize-export": "done",
    }
