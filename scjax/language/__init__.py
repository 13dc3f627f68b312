"""Facts and captions of scenes, and what prompts ask for: rules on lanes and boxes, without a learned model.

A scene becomes ``Facts`` (``facts.extract_facts``), facts become a caption (``captioner.write_caption``). A prompt
becomes a ``PromptSpec`` (``prompt_parser.parse_prompt``), which ``prompt_parser.check`` compares with facts.
"""
