"""The questions that a verdict answers: on convergence, on the law, and on the parameters."""

QUESTIONS = {
    "sampling": "Did the computation converge?",
    "law": "Does the model follow the data?",
    "knowledge": "Do the data identify the parameters?",
}
