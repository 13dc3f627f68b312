"""What scenes show and what texts ask of them: rules on lanes and boxes, without a learned model.

``attributes.table`` measures a scene and compares it with a request; ``grammar.compose`` writes texts that make one;
``reader`` turns what the reader's network answers into one.
"""
