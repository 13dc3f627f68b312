"""From recorded logs to training batches.

readers -> ``Log`` -> lane_graph, tiles (poses) -> local_map -> records (files) -> crop -> token_order -> loader.
``log_crop.crop_log`` goes from a log to a scene directly. Captions and their token features lie beside the records.
"""
