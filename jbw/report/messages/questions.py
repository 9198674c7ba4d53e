"""The three questions of a verdict."""

QUESTIONS = {
    "sampling": "Did the computation converge?",
    "law": "Does the model follow the data?",
    "knowledge": "Do the data identify the parameters?",
}
