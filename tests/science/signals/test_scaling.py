import numpy as np
import pandas as pd

from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT, Scaling


def test_what_was_standardised_is_restored(generator):
    samples = pd.DataFrame(100.0 * generator.standard_normal((20, 4)), columns=[*MODEL_INPUTS, MODEL_OUTPUT])
    scaling = Scaling(np.array([90.0, 0.1, 0.0]), np.array([40.0, 0.05, 2.0]), 100.0, 300.0)
    restored = scaling.restore_inputs(scaling.inputs_of(samples))
    np.testing.assert_allclose(restored, samples[list(MODEL_INPUTS)], rtol=1e-12)
    np.testing.assert_allclose(scaling.restore_force(scaling.output_of(samples)), samples[MODEL_OUTPUT], rtol=1e-12)
    np.testing.assert_allclose(scaling.restore_inputs(np.ones((1, 3))), [[130.0, 0.15, 2.0]])
