"""Drop a heap of household objects, find its target, and draw it."""

from pathlib import Path

from PIL import Image

from mechsearch import GenerateConfig, HeapEnv, generate, load_object_set

output = Path("heap.parquet")
output.unlink(missing_ok=True)
heaps = generate(GenerateConfig(condition="single", heaps=3, seed=7), output)
for heap in heaps.heaps:
    target = heap.objects[heap.target]
    print(f"{heap.count} objects; the target, {target}, is {heap.occlusion:.0%} occluded")

env = HeapEnv(heaps.heaps, load_object_set("household"), render_mode="rgb_array")
env.reset(seed=0, options={"heap": 0})
Image.fromarray(env.render()).save("heap.png")
