import pytest

from inpaint3d.contracts.models.report import AccuracySample
from inpaint3d.orchestrator.accuracy import judge_course, render_course


def sample(node: str, at: float, psnr: float) -> AccuracySample:
    return AccuracySample(node=node, wall_s=2 * at, cpu_s=at, psnr=psnr)


PRETRAINING = [sample("nerf-pretraining", at, psnr) for at, psnr in ((20, 21.0), (40, 24.0))]
MASKED = [sample("masked-reconstruction", 100 + at, 27.0 - 40.0 / at) for at in range(10, 110, 10)]


def test_in_hand_is_what_never_saw_the_object():
    course = judge_course(PRETRAINING + MASKED)
    assert course.in_hand_from == "masked-reconstruction"
    assert (course.half, course.last) == (MASKED[4], MASKED[-1])
    assert course.knee in MASKED[1:5]


def test_the_sentence_says_what_other_ends_would_have_been():
    course = judge_course(PRETRAINING + MASKED)
    assert (
        f"stopping half way (at 150 CPU s) would have cost {MASKED[-1].psnr - MASKED[4].psnr:.2f} dB" in course.sentence
    )
    assert f"would buy about {course.gain_db:+.2f} dB (95 %: " in course.sentence
    assert course.ahead_s == 90.0  # as long again as the last stage's scores span
    assert course.gain_db > 0


def test_too_few_scores_are_said():
    course = judge_course(MASKED[:3])
    assert course.gain_db is None
    assert "Too few scores of masked-reconstruction" in course.sentence


def test_the_fragment_draws_both_clocks_and_marks_the_knee():
    page = render_course(judge_course(PRETRAINING + MASKED))
    assert page.count("<svg") == 2
    assert page.count("</i>knee</span>") == 2
    assert "CPU seconds since the start" in page
    assert render_course(None) == ""


@pytest.mark.parametrize("count", [1, 2])
def test_one_score_is_a_course_without_a_knee(count):
    assert judge_course(MASKED[:count]).knee is None
