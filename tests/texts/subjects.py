"""The files of texts and what makes them."""

from tests.texts import Subject, cases_file

SUBJECTS: dict[str, Subject] = {
    "campaign-file": cases_file.campaign_file,
    "constants": cases_file.constants,
}
