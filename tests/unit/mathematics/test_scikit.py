import subprocess
import sys

PRELUDE = """
import sys
import numpy as np
from perfbound.orchestrator.mathematics.gp.kernels import Matern
"""


def run(text: str) -> str:
    """Return what a fresh process prints."""
    ended = subprocess.run([sys.executable, "-c", PRELUDE + text], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_the_kernel_needs_no_statistics() -> None:
    found = run(
        "Matern(10.0, 1.0)(np.array([0.5]))\n"
        "print('sklearn.gaussian_process.kernels' in sys.modules, 'scipy.stats' in sys.modules)"
    )
    assert found == "True False\n"


def test_what_uses_statistics_afterwards_gets_them() -> None:
    found = run(
        "Matern(10.0, 1.0)(np.array([0.5]))\n"
        "from sklearn.metrics import label_ranking_average_precision_score as score  # calls rankdata\n"
        "from sklearn.preprocessing import PowerTransformer  # takes an attribute of the module\n"
        "print(score(np.array([[1, 0, 0]]), np.array([[0.75, 0.5, 1.0]])))\n"
        "print(PowerTransformer('box-cox').fit_transform(np.array([[1.0], [2.0], [4.0]])).round(3).ravel())\n"
        "import scipy\n"
        "from scipy.stats import norm\n"
        "import scipy.stats.qmc\n"
        "assert scipy.stats.norm is norm and sys.modules['scipy.stats'] is scipy.stats\n"
        "print(norm.cdf(0.0), len(scipy.stats.qmc.Sobol(2).random(4)))"
    )
    assert found == "0.5\n[-1.225 -0.     1.225]\n0.5 4\n"


def test_statistics_that_are_there_already_stay() -> None:
    found = run(
        "import scipy.stats as there\nMatern(10.0, 1.0)(np.array([0.5]))\nprint(sys.modules['scipy.stats'] is there)"
    )
    assert found == "True\n"


def test_a_version_that_needs_more_of_them_gets_all() -> None:
    found = run(
        "from perfbound.orchestrator.mathematics.gp import scikit\n"
        "scikit.FUNCTIONS = ()\n"
        "print(Matern(0.5, 2.0)(np.array([2.0])).round(6), 'scipy.stats' in sys.modules)"
    )
    assert found == "[0.367879] True\n"
