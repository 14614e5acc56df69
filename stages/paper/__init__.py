"""The rest of the paper's study: baselines, time shifts, hyperpriors, learned models, a sparse model, the claims."""
