"""The files of texts and what makes them."""

from tests.texts import Subject, cases_certificate, cases_file, cases_link, cases_prepare, cases_run

SUBJECTS: dict[str, Subject] = {
    "campaign-file": cases_file.campaign_file,
    "constants": cases_file.constants,
    "verdicts": cases_certificate.verdicts,
    "claims": cases_certificate.claims,
    "show": cases_certificate.shown,
    "check-system": cases_prepare.check_system,
    "init": cases_prepare.init,
    "calibrate": cases_prepare.calibrate,
    "plan": cases_prepare.plan,
    "status": cases_run.status,
    "tls": cases_link.tls,
    "pki": cases_link.pki,
    "command-line": cases_link.command_line,
    "formulas": cases_link.formulas,
    "library": cases_link.library,
}
