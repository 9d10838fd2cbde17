// The words of the page: English, and the same in other languages; {} stands for a value.

/** Languages of the page, by their names. */
export const LANGUAGES = { en: 'English', de: 'Deutsch', fr: 'Français', zh: '中文', ja: '日本語' };

/** Each text in the languages after English. */
export const WORDS = {
  'The scene. Arrow keys turn, W A S D Q E fly, H lists all keys.': ['Die Szene. Pfeiltasten drehen, W A S D Q E fliegen, H zeigt alle Tasten.', 'La scène. Les flèches tournent, W A S D Q E volent, H affiche toutes les touches.', '场景。方向键旋转，W A S D Q E 飞行，H 列出所有按键。', 'シーン。矢印キーで回転、W A S D Q E で飛行、H でキー一覧。'],
  'Line between A and B': ['Linie zwischen A und B', 'Ligne entre A et B', 'A 与 B 之间的分界线', 'A と B の境界線'],
  'Try again': ['Erneut versuchen', 'Réessayer', '重试', '再試行'],
  Scene: ['Szene', 'Scène', '场景', 'シーン'],
  Refining: ['Wird verfeinert', 'Affinage', '正在细化', '詳細化中'],
  'Loading: {} %': ['Lädt: {} %', 'Chargement : {} %', '正在加载：{} %', '読み込み中：{} %'],
  'Stop loading': ['Laden anhalten', 'Arrêter le chargement', '停止加载', '読み込みを中止'],
  Show: ['Anzeige', 'Afficher', '显示', '表示'],
  Wipe: ['Geteilt', 'Volet', '分割', 'ワイプ'],
  Error: ['Fehler', 'Erreur', '误差', '誤差'],
  'Pixel error, of 255': ['Pixelfehler, von 255', 'Erreur par pixel, sur 255', '像素误差（最大 255）', '画素の誤差（最大 255）'],
  View: ['Ansicht', 'Vue', '视图', '視点'],
  Up: ['Oben', 'Haut', '上方向', '上方向'],
  cameras: ['Kameras', 'caméras', '相机', 'カメラ'],
  'SH degree': ['SH-Grad', 'Degré SH', '球谐阶数', 'SH 次数'],
  'SH degree {}': ['SH-Grad {}', 'degré SH {}', '球谐 {} 阶', 'SH {} 次'],
  'SH left out to save memory': ['SH aus Speichermangel weggelassen', 'SH omises faute de mémoire', '为节省内存省略部分球谐', 'メモリ節約のため SH を省略'],
  Background: ['Hintergrund', 'Arrière-plan', '背景', '背景'],
  black: ['schwarz', 'noir', '黑色', '黒'],
  grey: ['grau', 'gris', '灰色', '灰色'],
  white: ['weiß', 'blanc', '白色', '白'],
  'Maximum Gaussians, millions': ['Gaussians höchstens, Millionen', 'Gaussiennes au plus, millions', '高斯数量上限（百万）', 'ガウシアンの上限（百万）'],
  'Turn slowly': ['Langsam drehen', 'Tourner lentement', '缓慢旋转', 'ゆっくり回転'],
  Language: ['Sprache', 'Langue', '语言', '言語'],
  Theme: ['Farben', 'Thème', '主题', 'テーマ'],
  automatic: ['automatisch', 'automatique', '自动', '自動'],
  dark: ['dunkel', 'sombre', '深色', 'ダーク'],
  light: ['hell', 'clair', '浅色', 'ライト'],
  'Virtual reality': ['Virtuelle Realität', 'Réalité virtuelle', '虚拟现实', 'VR で見る'],
  'Full screen': ['Vollbild', 'Plein écran', '全屏', '全画面'],
  'Save picture': ['Bild speichern', 'Enregistrer l’image', '保存图片', '画像を保存'],
  'Copy link': ['Link kopieren', 'Copier le lien', '复制链接', 'リンクをコピー'],
  'Link copied': ['Link kopiert', 'Lien copié', '链接已复制', 'コピーしました'],
  'Bits per Gaussian': ['Bits pro Gaussian', 'Bits par gaussienne', '每个高斯的比特数', 'ガウシアンあたりのビット数'],
  positions: ['Positionen', 'positions', '位置', '位置'],
  opacity: ['Deckkraft', 'opacité', '不透明度', '不透明度'],
  scaling: ['Größe', 'échelle', '缩放', '大きさ'],
  rotation: ['Drehung', 'rotation', '旋转', '回転'],
  levels: ['Detailstufen', 'niveaux', '细节层次', '詳細レベル'],
  other: ['Sonstiges', 'autres', '其他', 'その他'],
  file: ['Datei', 'fichier', '文件', 'ファイル'],
  'Mouse and keys': ['Maus und Tasten', 'Souris et touches', '鼠标和按键', 'マウスとキー'],
  'drag, arrows': ['ziehen, Pfeile', 'glisser, flèches', '拖动、方向键', 'ドラッグ、矢印'],
  turn: ['drehen', 'tourner', '旋转', '回転'],
  'shift with drag or arrows, right drag, two fingers': ['Umschalt mit Ziehen oder Pfeilen, rechts ziehen, zwei Finger', 'Maj avec glisser ou flèches, glisser à droite, deux doigts', 'Shift 加拖动或方向键、右键拖动、双指', 'Shift とドラッグか矢印、右ドラッグ、二本指'],
  pan: ['verschieben', 'déplacer', '平移', '平行移動'],
  'wheel, pinch, + −': ['Rad, zwei Finger spreizen, + −', 'molette, pincer, + −', '滚轮、捏合、+ −', 'ホイール、ピンチ、+ −'],
  'move closer, farther away': ['näher, weiter weg', 'approcher, éloigner', '靠近、远离', '近づく、離れる'],
  'W A S D Q E, joystick': ['W A S D Q E, Joystick', 'W A S D Q E, manette', 'W A S D Q E、摇杆', 'W A S D Q E、スティック'],
  'fly; faster with shift': ['fliegen; schneller mit Umschalt', 'voler ; plus vite avec Maj', '飞行；按 Shift 加速', '飛行、Shift で速く'],
  'next, previous view': ['nächste, vorige Ansicht', 'vue suivante, précédente', '下一个、上一个视图', '次、前の視点'],
  'return to the view': ['zurück zur Ansicht', 'revenir à la vue', '回到视图', '視点に戻る'],
  overview: ['Überblick', 'vue d’ensemble', '总览', '全体'],
  'next up axis': ['nächste Achse nach oben', 'axe vertical suivant', '下一个上方向', '次の上方向'],
  'A, B, wipe, error': ['A, B, geteilt, Fehler', 'A, B, volet, erreur', 'A、B、分割、误差', 'A、B、ワイプ、誤差'],
  'flip between A and B': ['zwischen A und B wechseln', 'alterner A et B', '切换 A 和 B', 'A と B を切り替え'],
  'save a picture': ['ein Bild speichern', 'enregistrer une image', '保存图片', '画像を保存'],
  'copy a link to this': ['Link hierauf kopieren', 'copier un lien vers ceci', '复制当前链接', 'このリンクをコピー'],
  'next annotation': ['nächste Anmerkung', 'annotation suivante', '下一个注释', '次の注釈'],
  Close: ['Schließen', 'Fermer', '关闭', '閉じる'],
  'turn slowly, stop': ['langsam drehen, anhalten', 'tourner lentement, arrêter', '缓慢旋转、停止', 'ゆっくり回転、停止'],
  Tour: ['Rundgang', 'Visite', '漫游', 'ツアー'],
  'tour, stop': ['Rundgang, anhalten', 'visite, arrêter', '漫游、停止', 'ツアー、停止'],
  'hide all but the picture': ['nur das Bild zeigen', 'ne montrer que l’image', '只显示画面', '画像だけを表示'],
  'Letter shortcuts': ['Buchstaben als Tastenkürzel', 'Raccourcis par lettres', '字母快捷键', '文字キーのショートカット'],
  on: ['an', 'activé', '开', 'オン'],
  off: ['aus', 'désactivé', '关', 'オフ'],
  Play: ['Abspielen', 'Lire', '播放', '再生'],
  Pause: ['Anhalten', 'Pause', '暂停', '一時停止'],
  Frame: ['Einzelbild', 'Image', '帧', 'フレーム'],
  Space: ['Leertaste', 'espace', '空格', 'スペース'],
  'play, pause': ['abspielen, anhalten', 'lire, mettre en pause', '播放、暂停', '再生、一時停止'],
  'previous, next frame': ['voriges, nächstes Einzelbild', 'image précédente, suivante', '上一帧、下一帧', '前、次のフレーム'],
  'this list': ['diese Liste', 'cette liste', '此列表', 'この一覧'],
  '1 Gaussian': ['1 Gaussian', '1 gaussienne', '1 个高斯', 'ガウシアン 1 個'],
  '{} Gaussians': ['{} Gaussians', '{} gaussiennes', '{} 个高斯', 'ガウシアン {} 個'],
  '1 block': ['1 Block', '1 bloc', '1 个块', '1 ブロック'],
  '{} blocks': ['{} Blöcke', '{} blocs', '{} 个块', '{} ブロック'],
  'profile {}': ['Profil {}', 'profil {}', '配置 {}', 'プロファイル {}'],
  'encoded for this page': ['für diese Seite kodiert', 'encodé pour cette page', '为本页面编码', 'このページ用に符号化'],
  'views: {} dB against the original': ['Ansichten: {} dB zum Original', 'vues : {} dB par rapport à l’original', '视图：与原始相比 {} dB', '視点：原本比 {} dB'],
  '{}, loaded': ['{}, geladen', '{}, chargé', '{}，已加载', '{}、読み込み済み'],
  '{} fetched': ['{} geladen', '{} reçus', '已获取 {}', '取得 {}'],
  '{} drawn': ['{} gezeichnet', '{} affichées', '已绘制 {}', '描画 {}'],
  '{} of this view missing: picture, comparison and saved picture are coarser there.': ['{} dieser Ansicht fehlen: Dort wird gröber gezeichnet, verglichen und gespeichert.', '{} de cette vue manquent : affichage, comparaison et image y sont plus grossiers.', '此视图缺少 {}：该处的绘制、比较和保存较粗略。', 'この視点の {} が未取得：その部分の描画、比較、保存は粗くなります。'],
  'Stopped: the page shows what was loaded.': ['Angehalten: Die Seite zeigt, was geladen ist.', 'Arrêté : la page montre ce qui est chargé.', '已停止：页面显示已加载的部分。', '中止しました。読み込んだ分を表示しています。'],
  '{}: retrying': ['{}: neuer Versuch', '{} : nouvel essai', '{}：正在重试', '{}：再試行中'],
  'and {} more': ['und {} weitere', 'et {} autres', '以及另外 {} 个', 'ほか {} 件'],
  'a page opened from disk cannot read other files: use a web server, or share one .html file': ['Eine Seite von der Festplatte kann keine anderen Dateien lesen: Nutzen Sie einen Webserver oder eine einzige .html-Datei', 'une page ouverte depuis le disque ne peut pas lire d’autres fichiers : utilisez un serveur web ou un seul fichier .html', '从磁盘打开的页面不能读取其他文件：请使用网络服务器，或共享单个 .html 文件', 'ディスクから開いたページは他のファイルを読めません。ウェブサーバーか、単一の .html ファイルを使ってください'],
  'the graphics card was lost: reload the page': ['Die Grafikkarte ging verloren: Laden Sie die Seite neu', 'la carte graphique a été perdue : rechargez la page', '显卡连接丢失：请重新加载页面', 'グラフィックスが失われました。ページを再読み込みしてください'],
  'this browser has no WebGL 2': ['Dieser Browser hat kein WebGL 2', 'ce navigateur n’a pas WebGL 2', '此浏览器不支持 WebGL 2', 'このブラウザには WebGL 2 がありません'],
  '{}, this device draws at most {}': ['{}, dieses Gerät zeichnet höchstens {}', '{}, cet appareil en affiche au plus {}', '{}，此设备最多绘制 {}', '{}、この端末の上限は {} です'],
  '{}: the graphics card has too little memory': ['{}: Die Grafikkarte hat zu wenig Speicher', '{} : la carte graphique a trop peu de mémoire', '{}：显存不足', '{}：グラフィックスのメモリが足りません'],
};

/**
 * The language that an address asks for (`lang=de`), or else the first known one of a list.
 *
 * @param {string} hash
 * @param {string[]} preferred as the browser names them, such as `de-CH`
 */
export function languageOf(hash, preferred) {
  const asked = new URLSearchParams(hash.replace(/^#/, '')).get('lang');
  const names = [asked ?? '', ...preferred].map((name) => name.split('-')[0].toLowerCase());
  return names.find((name) => Object.hasOwn(LANGUAGES, name)) ?? 'en';
}

export const LANGUAGE = languageOf(globalThis.location?.hash ?? '', globalThis.navigator?.languages ?? []);

const place = Object.keys(LANGUAGES).indexOf(LANGUAGE) - 1;

/** A text in the page's language, with values in place of {}. */
export function say(text, ...values) {
  const parts = (WORDS[text]?.[place] ?? text).split('{}');
  return parts.reduce((said, part, k) => `${said}${values[k - 1]}${part}`);
}

/** A number with `digits` decimals. */
export const number = (value, digits = 0) =>
  value.toLocaleString(LANGUAGE, { minimumFractionDigits: digits, maximumFractionDigits: digits });

/** A number of bytes, in kB or MB. */
export const sizeText = (bytes) =>
  bytes < 999995 ? `${number(bytes / 1e3, 2)} kB` : `${number(bytes / 1e6, 2)} MB`;

/** A number and its noun: "1 Gaussian", "1,234 Gaussians". */
export const counted = (value, noun) =>
  value === 1 ? say(`1 ${noun}`) : say(`{} ${noun}s`, number(value));

/** Put the texts and names of the page's elements into its language. */
export function translate() {
  document.documentElement.lang = LANGUAGE;
  for (const one of document.querySelectorAll('body :not(script)')) {
    if (one.ariaLabel) one.ariaLabel = say(one.ariaLabel);
    for (const node of one.childNodes) {
      const text = node.nodeType === Node.TEXT_NODE && node.data.trim();
      if (text) node.data = node.data.replace(text, say(text));
    }
  }
}
