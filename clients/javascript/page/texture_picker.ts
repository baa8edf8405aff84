import type { TextureInfo } from "../client/index.js";
import { byId, element, setText, showText } from "./dom.js";
import type { Selection } from "./selection.js";
import type { Session } from "./session.js";
import { texts } from "./texts.js";
import { TextureThumbnails } from "./texture_thumbnails.js";

/** A texture in the list, with what the search looks at. */
interface Option {
  texture: TextureInfo;
  item: HTMLElement;
  searched: string;
}

/** Search field and list of the textures; a click or Enter selects one. */
export class TexturePicker {
  private readonly search = byId<HTMLInputElement>("search");
  private readonly list = byId("textures");
  private readonly empty = byId("textures-empty");
  private readonly status = byId("selected");
  private readonly problem = byId("select-problem");
  private readonly beside = byId<HTMLSelectElement>("beside");
  private readonly thumbnails: TextureThumbnails;
  private options: Option[] = [];
  private active: Option | undefined;

  constructor(private readonly session: Session, private readonly selection: Selection) {
    this.thumbnails = new TextureThumbnails(session, this.list);
    this.search.addEventListener("input", () => this.filter());
    this.beside.addEventListener("change", () => this.choose(this.beside.value, true));
    for (const target of [this.search, this.list]) {
      target.addEventListener("keydown", (event) => this.press(event));
    }
    session.displayChanged.on(() => void this.read());
    session.event.on(({ kind }) => kind === "textures" && void this.read());
    selection.changed.on(() => this.showStatus());
    selection.settled.on(({ name, error }) => this.settle(name, error));
  }

  private async read(): Promise<void> {
    this.showStatus();
    if (!this.session.display) return;
    try {
      this.fill(await this.session.connection.textures());
    } catch (error) {
      showText(this.problem, texts.noTextures((error as Error).message));
    }
  }

  private fill(textures: TextureInfo[]): void {
    this.thumbnails.clear();
    const sorted = [...textures].sort(byCategoryAndName);
    this.options = sorted.map((texture, number) => this.createOption(texture, number));
    const categories = new Map<string, HTMLElement>();
    for (const { texture, item } of this.options) {
      const { category } = texture;
      const group = categories.get(category) ?? createGroup(category, categories.size);
      categories.set(category, group);
      group.append(item);
    }
    this.list.replaceChildren(...categories.values());
    const { left } = this.selection.halves;
    this.active = this.options.find(({ texture }) => texture.name === left);
    const same = element("option", texts.sameBeside);
    same.value = "";
    this.beside.replaceChildren(same, ...sorted.map(({ name }) => element("option", name)));
    this.filter();
    this.showStatus();
  }

  private createOption(texture: TextureInfo, number: number): Option {
    const item = element("div", "", "option");
    item.setAttribute("role", "option");
    item.id = `texture-${number}`;
    item.dataset.testid = "texture";
    item.dataset.name = texture.name;
    item.append(
      this.thumbnails.create(texture.name),
      element("span", texture.name, "name"),
      element("span", texture.description, "description"),
      element("span", texts.provenance(texture.provenance), "provenance"),
    );
    const searched = `${texture.name} ${texture.category} ${texture.description}`.toLowerCase();
    const option = { texture, item, searched };
    item.addEventListener("click", () => this.chooseOption(option));
    return option;
  }

  private filter(): void {
    const words = this.search.value.toLowerCase().split(/\s+/);
    for (const { item, searched } of this.options) {
      item.hidden = !words.every((word) => searched.includes(word));
    }
    for (const group of this.list.children as HTMLCollectionOf<HTMLElement>) {
      group.hidden = group.querySelector(".option:not([hidden])") === null;
    }
    const shown = this.shown();
    showText(this.empty, shown.length ? "" : texts.noTextureMatches(this.search.value));
    if (this.active?.item.hidden) this.activate(undefined);
    else this.scrollToActive();
  }

  private shown(): Option[] {
    return this.options.filter(({ item }) => !item.hidden);
  }

  private press(event: KeyboardEvent): void {
    const shown = this.shown();
    const k = this.active ? shown.indexOf(this.active) : -1;
    const inList = event.currentTarget === this.list;
    let next: Option | undefined;
    if (event.key === "ArrowDown") next = shown[Math.min(k + 1, shown.length - 1)];
    else if (event.key === "ArrowUp") next = shown[Math.max(k - 1, 0)];
    else if (event.key === "Home" && inList) next = shown[0];
    else if (event.key === "End" && inList) next = shown[shown.length - 1];
    else if (event.key === "Enter" || (event.key === " " && inList)) {
      this.chooseOption(this.active ?? shown[0]);
    } else return;
    event.preventDefault();
    if (next) this.activate(next);
  }

  private activate(option: Option | undefined): void {
    this.active?.item.classList.remove("active");
    this.active = option;
    for (const target of [this.search, this.list]) {
      if (option) target.setAttribute("aria-activedescendant", option.item.id);
      else target.removeAttribute("aria-activedescendant");
    }
    option?.item.classList.add("active");
    this.scrollToActive();
  }

  /** Scroll the list, but not the page, until the active option is in sight. */
  private scrollToActive(): void {
    const { active, list } = this;
    if (!active) return;
    const heading = active.item.parentElement?.firstElementChild?.clientHeight ?? 0;
    const top = active.item.offsetTop - heading;
    const bottom = active.item.offsetTop + active.item.offsetHeight;
    if (top < list.scrollTop) list.scrollTop = top;
    else list.scrollTop = Math.max(list.scrollTop, bottom - list.clientHeight);
  }

  private chooseOption(option: Option | undefined): void {
    if (!option) return;
    this.activate(option);
    this.choose(option.texture.name);
  }

  private choose(name: string, isBeside = false): void {
    showText(this.problem, "");
    setText(this.status, texts.preparing(name || this.selection.halves.left));
    this.status.dataset.busy = "true";
    if (isBeside) this.selection.chooseBeside(name);
    else this.selection.choose(name);
  }

  private settle(name: string, error?: Error): void {
    if (error) showText(this.problem, texts.selectFailed(name, error.message));
    this.showStatus();
    this.session.changed.emit(this.session);
  }

  private showStatus(): void {
    delete this.status.dataset.busy;
    const { left, right } = this.selection.halves;
    setText(this.status, left ? texts.selected(left, right) : texts.nothingSelected);
    this.beside.value = right;
    this.beside.disabled = left === "";
    for (const { texture, item } of this.options) {
      item.setAttribute("aria-selected", String(texture.name === left));
    }
  }
}

function createGroup(category: string, number: number): HTMLElement {
  const group = element("div", "", "group");
  const heading = element("div", category, "category");
  heading.id = `category-${number}`;
  group.setAttribute("role", "group");
  group.setAttribute("aria-labelledby", heading.id);
  group.append(heading);
  return group;
}

function byCategoryAndName(a: TextureInfo, b: TextureInfo): number {
  return a.category.localeCompare(b.category) || a.name.localeCompare(b.name);
}
